
/** Comes when the picture is whole. */
async function rest() {
  while (body.dataset.state !== 'rest') {
    if (body.dataset.errors !== '0') throw new Error(body.dataset.error);
    await sleep(5);
  }
}

const pixels = () => context.getImageData(0, 0, canvas.width, canvas.height).data;
const same = (a, b) => a.length === b.length && a.every((x, i) => x === b[i]);

async function drag(way, id = 7, more = {}) {
  const place = canvas.getBoundingClientRect();
  const pointer = (type, [x, y]) => canvas.dispatchEvent(new PointerEvent(type, {
    pointerId: id, clientX: place.left + x, clientY: place.top + y, bubbles: true, buttons: 1, ...more,
  }));
  pointer('pointerdown', way[0]);
  for (const point of way) {
    pointer('pointermove', point);
    await sleep(20);
  }
  pointer('pointerup', way[way.length - 1]);
}

const ALL = ['rgb', 'opacity', 'ray_distance', 'z_depth', 'median_distance', 'normals'];

/** Floats of every plane of a fixed view, as hexadecimal bits, with the camera they are of. */
async function dump(kernel) {
  const camera = new Orbit(view.centre, view.home, view.up, view.across).camera(48, 36, ANGLE);
  const rect = { x: 0, y: 0, width: 48, height: 36 };
  const thread = new Thread(URL.createObjectURL(new Blob([element('library').textContent])));
  await thread.ask('open', { module: new WebAssembly.Module(bytes('module')), blob: bytes('blob'), kernel });
  const found = await thread.ask('render', { camera, rect, planes: ALL });
  // The same by rays of the page's own; and where a plane ends the rays, as by their own ends.
  const rays = await thread.ask('cameraRays', camera);
  const traced = await thread.ask('rays', { ...rays, planes: ALL });
  const t_max = found.planes.ray_distance.map((t, i) => i % 2 ? t : 0.9 * t);
  const cut = await thread.ask('rays', { ...rays, t_max, planes: ALL });
  const limited = await thread.ask('render', { camera, rect, planes: ALL, limits: { limit_ray_distance: t_max } });
  for (const name of ALL) {
    if (!same(traced.planes[name], found.planes[name])) throw new Error(`${kernel}: rays: ${name}`);
    if (!same(cut.planes[name], limited.planes[name])) throw new Error(`${kernel}: limits: ${name}`);
  }
  if (same(cut.planes.opacity, found.planes.opacity)) throw new Error(`${kernel}: limits end no ray`);
  thread.worker.terminate();
  const hex = floats => Array.from(new Uint32Array(floats.buffer), x => x.toString(16).padStart(8, '0')).join('');
  const exact = Object.fromEntries(Object.entries(camera).map(([name, value]) =>
    [name, Array.isArray(value) ? value.map(Math.fround) : Math.fround(value)]));
  return {
    camera: exact,
    planes: Object.fromEntries(Object.entries(found.planes).map(([name, floats]) => [name, hex(floats)])),
    macs: String(found.counters.macs),
  };
}

/** Leaves text in the document, for whoever reads it there. */
function leave(id, value) {
  const place = document.createElement('script');
  Object.assign(place, { type: 'application/json', id, textContent: JSON.stringify(value) });
  body.append(place);
}

/**
 * Drives the page as a person would and notes what failed; opened by adding #selftest to the address. With
 * `drag` it stops after the drag, with `look` before it: for pictures of the page.
 */
async function selfTest(words) {
  // The document is not loaded before this one is, so that a headless browser waits.
  const wait = document.createElement('iframe');
  wait.hidden = true;
  body.append(wait);
  wait.contentDocument.open();
  const failures = [];
  const check = (name, holds) => holds || failures.push(name);
  const look = words.includes('look') || words.includes('drag');
  if (!look) element('size').add(new Option(64, 64, true, true));
  try {
    await rest();
    if (!words.includes('look')) await drive(check, words);
  } catch (error) {
    failures.push(String(error.message || error));
  }
  body.dataset.selftest = failures.length ? `failed: ${failures.join('; ')}` : 'passed';
  wait.contentDocument.close();
}

async function drive(check, words) {
  const first = pixels();
  body.dataset.different = new Set(new Uint32Array(first.buffer)).size;
  const eye = String(view.backward()), quick = Number(body.dataset.quick);
  const way = Array.from({ length: 8 }, (_, i) => [200 + 15 * i, 200 + 4 * i]);
  await drag(way);
  check('drag turns', String(view.backward()) !== eye);
  await rest();
  check('frames while it moves', Number(body.dataset.quick) > quick);
  check('drag changes the picture', !same(pixels(), first));
  if (words.includes('drag')) return;

  const distance = view.distance;
  canvas.dispatchEvent(new WheelEvent('wheel', { deltaY: -200, cancelable: true }));
  check('wheel comes nearer', view.distance < distance);
  const near = view.distance, touch = { pointerType: 'touch' };
  const still = drag(Array(8).fill([100, 100]), 1, touch);
  await drag(Array.from({ length: 6 }, (_, i) => [150 + 20 * i, 150]), 2, touch);
  await still;
  check('pinch comes nearer', view.distance < near);
  const press = key => canvas.dispatchEvent(new KeyboardEvent('keydown', { key, bubbles: true }));
  const turned = String(view.backward());
  press('ArrowLeft');
  check('arrow turns', String(view.backward()) !== turned);
  press('r');
  await rest();
  check('reset brings the same bits back', same(pixels(), first));
  check('the pace is known', !info.front_points || pace.some(Number.isFinite));

  let last = first;
  for (const name of ['depth', 'normals']) {
    document.querySelector(`input[value=${name}]`).click();
    await rest();
    check(`${name} is another picture`, !same(pixels(), last));
    check(`${name} has its legend`, element('legend').hidden === (name !== 'depth'));
    last = pixels();
  }
  document.querySelector('input[value=colour]').click();
  element('kernel').value = 'portable';
  element('kernel').dispatchEvent(new Event('change', { bubbles: true }));
  while (body.dataset.kernel !== 'portable') await sleep(5);
  await rest();
  check('the portable kernel draws the same bits', same(pixels(), first));
  check('the frame is explained', element('explain').textContent.length > 200);
  for (const kernel of ['simd128', 'portable']) leave(`dump-${kernel}`, await dump(kernel));
  leave('layouts', await threads[0].ask('layouts'));
}
