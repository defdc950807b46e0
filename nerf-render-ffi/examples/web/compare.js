
/** Photographs of the data set: `{ name, camera, picture }`. */
let photographs = [];

async function readPhotographs() {
  const text = element('views').textContent.trim();
  const found = text ? JSON.parse(text) : body.dataset.live ? await fetched('views.json', answer => answer.json()) : null;
  photographs = found?.views ?? [];
  element('compare').hidden = !photographs.length;
  element('photograph').append(...photographs.map(({ name }, i) => new Option(name, i)));
}

/** The photograph that is compared with, or null. */
let photograph = null;

/** Compares with a photograph, or with none: from its camera, left of the split the photograph, right of it the field. */
function compare(index) {
  photograph = photographs[index] ?? null;
  element('photograph').value = photograph ? index : '';
  const image = element('photo');
  image.hidden = element('split').hidden = !photograph;
  if (photograph) image.src = photograph.picture;
  split(0.5);
  resize();
}

function split(share) {
  const percent = 100 * Math.max(0, Math.min(1, share));
  element('photo').style.clipPath = `inset(0 ${100 - percent}% 0 0)`;
  element('split').style.left = `${percent}%`;
  body.dataset.split = percent.toFixed(0);
}
