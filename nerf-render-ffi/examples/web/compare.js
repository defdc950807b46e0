/** Photographs of the data set: `{ name, camera, picture }`. */
let photographs = [];

async function readPhotographs() {
  const text = element('views').textContent.trim();
  const found = text ? JSON.parse(text) : body.dataset.live ? await latest('views.json', answer => answer.json()) : null;
  photographs = found?.views ?? [];
  element('compare').hidden = !photographs.length;
  element('photograph').append(...photographs.map(({ name }, i) => new Option(name, i)));
}

/** The photograph that is compared with, or null. */
let photograph = null;

/** Compares with a photograph, or with none: from its camera, left of the split the photograph, right of it the render. */
function compare(index) {
  photograph = photographs[index] ?? null;
  element('photograph').value = photograph ? index : '';
  if (photograph) element('photo').src = photograph.picture;
  tellPhotograph();
  split(0.5);
  resize();
  cover();
}

/** Shows the photograph and the split, but not in a flight. */
function tellPhotograph() {
  for (const id of ['photo', 'split']) element(id).hidden = !photograph || Boolean(flying);
}

function split(share) {
  const percent = 100 * Math.max(0, Math.min(1, share));
  element('photo').style.clipPath = `inset(0 ${100 - percent}% 0 0)`;
  element('split').style.left = `${percent}%`;
  body.dataset.split = percent.toFixed(0);
}
