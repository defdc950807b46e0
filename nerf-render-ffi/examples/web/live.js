/** Between two looks for a newer checkpoint. */
const LOOK_MS = 250;

/** What a server says now, or null where it has none (yet), or is away for half a second. */
const latest = (name, read) => fetched(name, { cache: 'no-store' }).then(read).catch(() => null);

/** The page's first blob: its own, or the first that `nerf-train fit --live` puts beside it. */
async function firstBlob() {
  if (!body.dataset.live) return (await fetched(dataOf('blob', 'application/octet-stream'))).blob();
  element('facts').textContent = 'waiting for live.nerf: nerf-train fit DATA -o FILE --live DIR';
  for (;;) {
    const state = await latest('live.json', answer => answer.text());
    const blob = state && await latest('live.nerf', answer => answer.blob());
    if (blob) {
      seen = state;
      return blob;
    }
    await sleep(LOOK_MS);
  }
}

/** The text of live.json that belongs to what is shown. */
let seen = null;

function tellLive() {
  const { step, seconds, train_psnr_db, val_psnr_db, done } = JSON.parse(seen);
  const val = val_psnr_db === undefined ? '' : `, validation ${val_psnr_db.toFixed(2)} dB`;
  element('live').textContent = `${done ? 'trained' : 'training'}: step ${step}, ${seconds.toFixed(1)} s, ` +
    `${train_psnr_db.toFixed(2)} dB${val}`;
  body.dataset.liveSteps = `${body.dataset.liveSteps || ''} ${step}`.trim();
}

/** Shows a checkpoint that is not shown yet; whether it is another run's instead. */
async function update() {
  const state = await latest('live.json', answer => answer.text());
  if (!state || state === seen) return false;
  if (JSON.parse(state).step < JSON.parse(seen).step) return true;
  const newer = await latest('live.nerf', answer => answer.blob());
  if (!newer) return false;
  seen = state;
  await scene.open(newer);
  blob = newer;
  tellLive();
  element('status').textContent = '';
  return false;
}

/** Shows newer checkpoints for as long as the page is open; another run needs the page anew. */
async function follow() {
  tellLive();
  for (let another = false; !another;) {
    await sleep(LOOK_MS);
    try {
      another = await update();
    } catch (error) {
      element('status').textContent = `live.nerf: ${error.message}`;
    }
  }
  location.reload();
}
