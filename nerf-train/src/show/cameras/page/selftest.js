
/** Drives the page as a person would and notes what failed; opened by adding #selftest to the address. */
function selfTest() {
  const failures = [];
  const check = (name, holds) => holds || failures.push(name);
  const state = () => { draw(); return { ...body.dataset }; };
  const pointer = (type, x, y, more) => canvas.dispatchEvent(
    new PointerEvent(type, { pointerId: 7, clientX: x, clientY: y, bubbles: true, buttons: 1, ...more }));
  const drag = more => {
    pointer('pointerdown', 300, 300, more);
    pointer('pointermove', 360, 330, more);
    pointer('pointerup', 360, 330, more);
  };
  const press = key => canvas.dispatchEvent(new KeyboardEvent('keydown', { key, bubbles: true }));
  const first = state();
  const pixels = context.getImageData(0, 0, canvas.width, canvas.height).data;
  let inked = 0;
  for (let i = 0; i < pixels.length; i += 4) inked += pixels[i] + pixels[i + 1] + pixels[i + 2] < 600;
  body.dataset.ink = (inked / (pixels.length / 4)).toFixed(4);

  const fits = content().map(p => view.project(p)).every(
    p => p && p[0] >= 0 && p[0] <= view.width && p[1] >= 0 && p[1] <= view.height);
  check('everything is in the picture', fits);

  const turned = [() => drag({}), () => drag({ shiftKey: true }), () => drag({ buttons: 2 })];
  const names = ['drag turns', 'shift drag moves', 'right drag moves'];
  turned.forEach((act, i) => {
    const eye = [...view.backward];
    act();
    check(names[i], state().matrix !== first.matrix);
    check(`${names[i]}, as it should`, (String(eye) !== String(view.backward)) === (i === 0));
    press('r');
    check(`reset after ${names[i]}`, state().matrix === first.matrix);
  });
  canvas.dispatchEvent(new WheelEvent('wheel', { deltaY: -200, cancelable: true }));
  check('wheel zooms', state().matrix !== first.matrix);
  press('t');
  check('T looks from above', dot(view.backward, data.up) > 0.999 && state().matrix !== first.matrix);
  press('r');

  if (!data.alone) {
    const last = data.cameras.length - 1;
    element('camera').value = String(last);
    element('camera').dispatchEvent(new Event('change'));
    const alone = state();
    check('one camera', alone.cameras === '1' && alone.images === '1');
    check('its rays only', rays().length > 0 && rays().every(ray => ray.camera === last));
    press('a');
    check('all again', state().cameras === first.cameras && state().matrix === first.matrix);
  }
  for (const [box, kind] of [['images', 'images'], ['rays', 'rays'], ['live', 'live']]) {
    element(box).click();
    check(`${box} off`, state()[kind] === '0');
    element(box).click();
    check(`${box} on`, state()[kind] === first[kind]);
  }
  const began = performance.now();
  for (let i = 0; i < 5; i++) draw();
  context.getImageData(0, 0, 1, 1);
  body.dataset.frame = ((performance.now() - began) / 5).toFixed(1);
  body.dataset.selftest = failures.length ? `failed: ${failures.join('; ')}` : 'passed';
}
