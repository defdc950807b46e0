/** Comes when the picture is whole. */
async function rest() {
  while (!picture?.resting || body.dataset.ready !== 'true') {
    if (body.dataset.errors !== '0') throw new Error(body.dataset.error);
    await sleep(5);
  }
}

const pixels = () => canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
const same = (a, b) => a.length === b.length && a.every((x, i) => x === b[i]);

async function drag(way, id = 7, more = {}) {
  const place = canvas.getBoundingClientRect();
  const pointer = (type, [x, y]) => canvas.dispatchEvent(new PointerEvent(type, {
    pointerId: id, clientX: place.left + x, clientY: place.top + y, bubbles: true, composed: true, buttons: 1, ...more,
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
  const { centre, home, up, across } = picture.view, camera = new Orbit(centre, home, up, across).camera(48, 36, ANGLE);
  const rect = { x: 0, y: 0, width: 48, height: 36 };
  const thread = new Thread();
  await thread.ask('open', { module: await library(), blob, kernel });
  const found = await thread.ask('render', { camera, rect, planes: ALL });
  // Rays of the page's own give the same planes, and limits in a plane the same as the rays' own t_max.
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
  const bent = { ...camera, k1: 0.1 }, planes = ['rgb'];
  const seen = await thread.ask('render', { camera: bent, rect, planes });
  const through = await thread.ask('rays', { ...await thread.ask('cameraRays', bent), planes });
  if (!same(through.planes.rgb, seen.planes.rgb)) throw new Error(`${kernel}: rays through a lens`);
  thread.end();
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

/** Does something that changes the picture; comes when it is whole. */
async function show(...steps) {
  for (const step of steps) {
    step();
    await rest();
  }
}

/** Sets a control as a person does. */
function set(id, value) {
  const control = element(id);
  if (typeof value === 'boolean') control.checked = value; else control.value = value;
  for (const kind of ['input', 'change']) control.dispatchEvent(new Event(kind, { bubbles: true }));
}

async function crops(check, first) {
  await show(() => set('crop', true));
  const whole = pixels();
  // A crop to the whole box removes nothing but some bins at the sides of the box.
  const off = whole.filter((x, i) => Math.abs(x - first[i]) > 24).length / whole.length;
  check(`the whole box shows the whole scene (${off})`, off < 0.02);
  await show(() => set('crop-max-2', 50));
  const lower = pixels();
  check('half of the box shows less', !same(lower, whole));
  await show(() => set('crop-min-2', 50));
  check('an empty box shows what is behind', new Set(new Uint32Array(pixels().buffer)).size === 1);
  set('crop-min-2', 0);
  set('crop-max-2', 100);
  await show(() => set('crop', false));
  check('without a box all is there again', same(pixels(), first));
}

async function flies(check, press) {
  const from = picture.view.pose();
  press('k');
  scene.turn(60, 30);
  scene.dolly(0.8);
  press('k');
  scene.turn(90, -10);
  press('k');
  await rest();
  const last = picture.view.pose(), still = pixels();
  check('three keyframes', element('keyframes').textContent === '3 keyframes');
  element('seconds').value = 0.3;
  const quick = Number(body.dataset.quick);
  element('preview').click();
  await rest();
  while (flying) await sleep(5);
  await rest();
  check('the preview moves', Number(body.dataset.quick) > quick + 2 && Number(body.dataset.flown) > 1);
  check('and ends where it began', same(pixels(), still));
  const path = pathNow(), near = (a, b) => a.every((x, i) => Math.abs(x - b[i]) < 1e-4);
  check('it is 0.3 seconds long', path.camera_path.length === Math.round(0.3 * FPS));
  check('from the first view', near(path.camera_path[0].camera_to_world.slice(0, 12), from));
  check('to the last', near(path.camera_path.at(-1).camera_to_world.slice(0, 12), last));
  element('seconds').value = 4;
  const ways = pathNow().camera_path.map(({ camera_to_world: m }) => [placeOf(m), turnOf(m)]);
  const steps = ways.slice(1).map(([place, turn], i) =>
    Math.hypot(...add(place, ways[i][0], -1)) + 2 * Math.acos(Math.min(1, Math.abs(dot(turn, ways[i][1])))));
  check('at an even speed', Math.max(...steps) < 3 * Math.min(...steps));
  const zoomed = flight([{ ...keyframes[0], fov: 0.5 }, { ...keyframes[1], fov: 1 }])(0.5).fov;
  check('the focal length is interpolated', Math.abs(Math.tan(0.5 * zoomed) ** 2 - Math.tan(0.25) * Math.tan(0.5)) < 1e-6);
  const { info } = picture, { data } = info;
  info.data += ', origin at (1000000, -0.5, 20)';
  const { keyframes: [{ matrix }], camera_path: [{ camera_to_world: moved }] } = pathNow();
  info.data = data;
  const there = add(placeOf(from), [1000000, -0.5, 20]);
  check('a path is in the coordinates of the data', near(placeOf(moved), there) && near(placeOf(matrix), there));
  element('clear').click();
  check('no keyframes are left', element('preview').disabled && element('save').disabled);
}

async function compares(check) {
  if (!photographs.length) return;
  await show(() => set('photograph', 0));
  const image = element('photo'), { camera } = photographs[0];
  await image.decode();
  check('the photograph is shown', !image.hidden && image.naturalWidth > 0 && body.dataset.split === '50');
  check('in its own shape', Math.abs(canvas.width / canvas.height - camera.width / camera.height) < 0.05);
  check('from its camera', same(keyframeNow().pose, camera.c2w));
  await drag([[10, 10], [20, 10]]);
  check('a drag moves the split', Number(body.dataset.split) < 20);
  const eye = String(picture.view.pose());
  scene.turn(60, 30);
  scene.dolly(0.8);
  check('a photograph keeps its view', String(picture.view.pose()) === eye);
  actions.keep();
  check('its keyframe has its field of view', Math.abs(Math.tan(0.5 * keyframes[0].fov) - 0.5 * camera.height / camera.fy) < 1e-6);
  actions.keep();
  element('seconds').value = 0.1;
  const flown = preview();
  check('a preview hides it', image.hidden);
  await flown;
  check('and shows it again', !image.hidden && keyframeNow().fov === keyframes[0].fov);
  element('clear').click();
}

/** Waits until a newer checkpoint is shown than the first. */
async function sharpen(check) {
  const first = pixels();
  while (body.dataset.liveSteps.split(' ').length < 2) await sleep(20);
  await rest();
  check('the newer checkpoint is another picture', !same(pixels(), first));
}

/**
 * Milliseconds of a frame in colour, 400×400: by the module alone in one call on one thread, and by an element of one thread
 * from its first ray to its last pixel; the fastest of some, in turn. And by an element of all threads.
 */
async function times() {
  const thread = new Thread(), look = { mode: 'colour', range: [0, 1] }, fastest = [Infinity, Infinity, Infinity];
  await thread.ask('open', { module: await library(), blob, kernel: 'simd128' });
  const views = [1, ''].map(threads => {
    const view = document.createElement('nerf-view');
    for (const [name, value] of Object.entries({ threads, pixels: 400 })) view.setAttribute(name, value);
    return view;
  });
  // The page's own element is removed, so that only the measured elements draw.
  scene.remove();
  for (let turn = 0; turn < 20; turn++) {
    for (const [i, view] of views.entries()) {
      const drawn = new Promise(resolve => view.addEventListener('draw', function told({ detail }) {
        if (!detail.full) return;
        view.removeEventListener('draw', told);
        resolve(detail.milliseconds);
      }));
      if (turn) view.picture.change(); else { body.append(view); await view.open(blob); }
      fastest[i + 1] = Math.min(fastest[i + 1], await drawn);
    }
    const camera = views[0].picture.camera(400, 400), rect = { x: 0, y: 0, width: 400, height: 400 };
    fastest[0] = Math.min(fastest[0], (await thread.ask('paint', { camera, rect, look })).milliseconds);
  }
  body.dataset.times = fastest.map(time => time.toFixed(1)).join(' ');
}

/**
 * Drives the page as a person would and notes what failed; opened by adding #selftest to the address. With
 * `drag` it stops after the drag, with `look` before it: for pictures of the page.
 */
async function selfTest(words) {
  // The document is loaded only after this frame, so that a headless browser waits.
  const wait = document.createElement('iframe');
  wait.hidden = true;
  body.append(wait);
  wait.contentDocument.open();
  const failures = [];
  const check = (name, holds) => holds || failures.push(name);
  const looking = ['look', 'drag', 'compare', 'crop'].some(word => words.includes(word));
  if (!looking) element('size').add(new Option(64, 64, true, true));
  try {
    await rest();
    if (words.includes('times')) await times();
    else if (words.includes('live')) await sharpen(check);
    else if (words.includes('compare')) await show(() => compare(0));
    else if (words.includes('crop')) await show(() => set('crop', true), () => set('crop-max-2', 55));
    else if (!words.includes('look')) await drive(check, words);
  } catch (error) {
    failures.push(String(error.message || error));
  }
  body.dataset.selftest = failures.length ? `failed: ${failures.join('; ')}` : 'passed';
  wait.contentDocument.close();
}

async function drive(check, words) {
  const first = pixels();
  body.dataset.different = new Set(new Uint32Array(first.buffer)).size;
  const eye = String(picture.view.backward()), quick = Number(body.dataset.quick);
  const way = Array.from({ length: 8 }, (_, i) => [200 + 15 * i, 200 + 4 * i]);
  await drag(way);
  check('drag turns', String(picture.view.backward()) !== eye);
  await rest();
  check('frames while it moves', Number(body.dataset.quick) > quick);
  check('drag changes the picture', !same(pixels(), first));
  if (words.includes('drag')) return;

  const { distance } = picture.view;
  canvas.dispatchEvent(new WheelEvent('wheel', { deltaY: -200, cancelable: true }));
  check('wheel comes nearer', picture.view.distance < distance);
  const near = picture.view.distance, touch = { pointerType: 'touch' };
  const still = drag(Array(8).fill([100, 100]), 1, touch);
  await drag(Array.from({ length: 6 }, (_, i) => [150 + 20 * i, 150]), 2, touch);
  await still;
  check('pinch comes nearer', picture.view.distance < near);
  const press = key => canvas.dispatchEvent(new KeyboardEvent('keydown', { key, bubbles: true, composed: true }));
  const turned = String(picture.view.backward());
  press('ArrowLeft');
  check('arrow turns', String(picture.view.backward()) !== turned);
  press('r');
  await rest();
  check('reset brings the same bits back', same(pixels(), first));
  check('the pace is known', !picture.info.front_points || picture.pace.some(Number.isFinite));

  let last = first;
  for (const name of MODE_NAMES.slice(1)) {
    document.querySelector(`input[value=${name}]`).click();
    await rest();
    check(`${name} is another picture`, !same(pixels(), last));
    check(`${name} has its legend`, element('legend').hidden === (name === 'normals'));
    last = pixels();
  }
  for (const [id, value] of [['map', 'turbo'], ['high', Number(element('high').value) + 1]]) {
    await show(() => set(id, value));
    check(`${id} changes the colours`, !same(pixels(), last));
    last = pixels();
  }
  await show(() => element('auto').click());
  document.querySelector('input[value=colour]').click();
  await rest();
  check('the same bits in colour', same(pixels(), first));
  await crops(check, first);
  await flies(check, press);
  await compares(check);
  await show(() => actions.reset());
  check('the same bits after all of it', same(pixels(), first));
  element('kernel').value = 'portable';
  element('kernel').dispatchEvent(new Event('change', { bubbles: true }));
  while (body.dataset.kernel !== 'portable') await sleep(5);
  await rest();
  check('the portable kernel draws the same bits', same(pixels(), first));
  check('the frame is explained', element('explain').textContent.length > 200);
  for (const kernel of ['simd128', 'portable']) leave(`dump-${kernel}`, await dump(kernel));
  leave('layouts', await picture.threads[0].ask('layouts'));
}
