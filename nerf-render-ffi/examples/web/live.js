
/** Between two looks for a newer blob. */
const LOOK_MS = 250;

/** What a server says now, or null where it has none (yet). */
async function fetched(name, read) {
  try {
    const answer = await fetch(name, { cache: 'no-store' });
    return answer.ok ? await read(answer) : null;
  } catch (error) {
    return null; // not there yet, half a second of no server
  }
}

/** The page's first blob: its own, or the first that `nerf-train fit --live` puts beside it. */
async function firstBlob() {
  if (!body.dataset.live) return bytes('blob');
  element('facts').textContent = 'waiting for live.nerf: nerf-train fit DATA -o FILE --live DIR';
  for (;;) {
    const state = await fetched('live.json', answer => answer.json());
    const blob = state && await fetched('live.nerf', async answer => new Uint8Array(await answer.arrayBuffer()));
    if (blob) {
      seen = state;
      return blob;
    }
    await sleep(LOOK_MS);
  }
}

/** The state that is shown. */
let seen = null;

function tellLive() {
  const { step, seconds, train_psnr_db, val_psnr_db, done } = seen;
  const val = val_psnr_db === undefined ? '' : `, validation ${val_psnr_db.toFixed(2)} dB`;
  element('live').textContent = `${done ? 'trained' : 'training'}: step ${step}, ${seconds.toFixed(1)} s, ` +
    `${train_psnr_db.toFixed(2)} dB${val}`;
  body.dataset.liveSteps = `${body.dataset.liveSteps || ''} ${step}`.trim();
}

/** Shows whatever is newer, for as long as the page is open: a run may begin again. */
async function follow() {
  tellLive();
  for (;;) {
    await sleep(LOOK_MS);
    const state = await fetched('live.json', answer => answer.json());
    if (!state || (state.step === seen.step && state.done === seen.done)) continue;
    const blob = await fetched('live.nerf', async answer => new Uint8Array(await answer.arrayBuffer()));
    if (!blob) continue;
    seen = state;
    await reopen(blob);
    tellLive();
  }
}
