
/** The camera of a picture of this size: of a flight, of a photograph, or the one that goes around. */
function cameraNow(width, height) {
  if (flying) return cameraOf(flying.pose, width, height, 0.5 * height / Math.tan(0.5 * flying.fov));
  return photograph ? resized(photograph.camera, width, height) : view.camera(width, height, ANGLE);
}

/** A keyframe of what is shown: its pose, and its vertical field of view in radians. */
function keyframeNow() {
  const { c2w, height, fy } = cameraNow(canvas.width, canvas.height);
  return { pose: [...c2w], fov: 2 * Math.atan(0.5 * height / fy) };
}

/** Where most of the numbers of a picture lie that are of something opaque. */
function rangeOf(mode, tiles) {
  const name = MODES[mode].planes.at(-1);
  if (mode === 'opacity') return [0, 1];
  const numbers = tiles.flatMap(({ planes }) => planes.opacity
    ? Array.from(planes[name]).filter((_, i) => planes.opacity[i] > 0.5) : []).sort((a, b) => a - b);
  if (!numbers.length) return [0, 1];
  const [low, high] = [0.02, 0.98].map(share => numbers[Math.floor(share * (numbers.length - 1))]);
  return [low, Math.max(high, low + 1e-6 * Math.abs(low) + 1e-9)];
}

/** A tile's colours as they are now to be shown. */
const developed = ({ rect, planes }) => new ImageData(colours(look.mode, planes, rect.width * rect.height,
  mapOf(look.mode, look.map), look.range ?? ownRange), rect.width, rect.height);

/** Tiles of a picture, those in the middle first. */
function tiles(width, height) {
  const all = [];
  for (let y = 0; y < height; y += TILE) for (let x = 0; x < width; x += TILE) {
    all.push({ x, y, width: Math.min(TILE, width - x), height: Math.min(TILE, height - y) });
  }
  const off = tile => Math.hypot(tile.x + 0.5 * TILE - 0.5 * width, tile.y + 0.5 * TILE - 0.5 * height);
  return all.sort((a, b) => off(a) - off(b));
}

/**
 * Renders a picture tile by tile on all threads, which `take` gets as they come, until it is done or not `wanted`.
 * Returns the work and the threads' milliseconds, or null where it was not wanted to the end.
 */
async function frame(request, take, wanted) {
  const { width, height } = request.camera;
  const left = tiles(width, height), counters = {};
  let busy = 0, whole = true;
  await Promise.all(threads.map(async thread => {
    while (left.length) {
      const rect = left.shift();
      const found = await thread.ask('render', { ...request, rect });
      if (!wanted()) { whole = false; return; }
      busy += found.milliseconds;
      for (const [name, count] of Object.entries(found.counters)) {
        if (name !== 'struct_size') counters[name] = (counters[name] || 0n) + count;
      }
      take({ rect, planes: found.planes });
    }
  }));
  return whole ? { counters, busy } : null;
}

/** Settings and size of a frame that should take `MOVING_MS`: by the scene's front where it has one, then by size. */
async function quick() {
  const { width, height } = canvas;
  let options = null, loss = null, expected = pixelMs;
  if (pace) {
    const found = await threads[0].ask('within', { milliseconds: MOVING_MS * threads.length, pace });
    loss = found.choice.loss_db;
    options = found.options;
    expected ??= found.choice.milliseconds / (width * height);
  }
  const pixels = expected ? MOVING_MS * threads.length / expected : 0;
  const share = Math.max(1 / 8, Math.min(1, Math.sqrt(pixels / (width * height))));
  const size = [width, height].map(side => Math.max(16, Math.round(share * side)));
  return { options, loss, size };
}

/** One picture as fast as it must be, whatever happens meanwhile, shown when it is whole. */
async function drawQuickly() {
  const { options, loss, size: [width, height] } = await quick();
  const began = performance.now(), tiles = [];
  const { mode, crop } = look, planes = MODES[mode].planes;
  const { busy } = await frame({ camera: cameraNow(width, height), options, planes, crop },
    tile => tiles.push(tile), () => true);
  pixelMs = busy / (width * height);
  // Of another kind by now, perhaps.
  if (mode === look.mode) {
    const small = new OffscreenCanvas(width, height), ink = small.getContext('2d', { alpha: false });
    if (MODES[mode].unit) ownRange = rangeOf(mode, tiles);
    for (const tile of tiles) ink.putImageData(developed(tile), tile.rect.x, tile.rect.y);
    context.drawImage(small, 0, 0, canvas.width, canvas.height);
    tellRange();
  }
  const spent = performance.now() - began, lost = loss === null ? '' : `, ${loss.toFixed(2)} dB lost`;
  element('moving').textContent =
    `${Math.round(1000 / spent)} frames/s: ${Math.round(spent)} ms at ${width}×${height}${lost}`;
  Object.assign(body.dataset, {
    quick: Number(body.dataset.quick || 0) + 1, quickWidth: width, framesASecond: Math.round(1000 / spent),
  });
  body.dataset.firstPicture ??= Date.now();
  painted();
}

/** The picture in full, tile by tile, unless the view changes meanwhile. */
async function drawFully(now) {
  const { planes } = MODES[look.mode], { width, height } = canvas;
  const began = performance.now();
  const done = await frame({ camera: cameraNow(width, height), planes, crop: look.crop },
    tile => context.putImageData(developed(tile), tile.rect.x, tile.rect.y), () => generation === now);
  if (!done) return;
  const spent = performance.now() - began;
  const rate = 2 * Number(done.counters.macs) / done.busy / 1e6;
  element('still').textContent = `${Math.round(spent)} ms at ${width}×${height}`;
  element('threads').textContent = `${threads.length}, ${rate.toFixed(1)} GFLOP/s each`;
  element('explain').textContent = await threads[0].ask('explain', { planes, counters: done.counters });
  body.dataset.milliseconds = Math.round(spent);
}

/** The whole life of the page: a quick picture for each change, and the full one at rest. */
async function draw() {
  for (;;) {
    const now = generation;
    const next = new Promise(resolve => { changed = resolve; });
    for (const thread of retired.splice(0)) thread.worker.terminate();
    await drawQuickly();
    await Promise.race([next, sleep(REST_MS)]);
    if (generation !== now || flying) continue;
    await drawFully(now);
    if (generation !== now) continue;
    if (info.front_points && !pace) {
      // Only now, since nothing else may run; it decides the next quick picture.
      const camera = cameraNow(canvas.width, canvas.height);
      const limit = 4 * MOVING_MS * threads.length;
      const found = await threads[0].ask('pace', { camera, planes: MODES.colour.planes, limit });
      // Of another size or kernel by now, perhaps.
      if (generation !== now) continue;
      pace = found;
      pixelMs = null;
      body.dataset.pace = pace.map(x => Number.isFinite(x) ? x.toFixed(1) : '').join(' ').trim();
    }
    body.dataset.state = generation === now ? 'rest' : 'moving';
    await next;
  }
}

