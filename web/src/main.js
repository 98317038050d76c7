// The page: loads everything, keeps time, and hands on what is turned and pressed.
import loadMujoco from '@mujoco/mujoco';
import { Readouts } from './readouts.js';
import { Robot, loadController } from './robot.js';
import { Stage } from './stage.js';

const PUSH = 200; // [N]
const STOOD_UP_AFTER = 1.0; // after a fall [s]
const pick = (id) => document.querySelector(`#${id}`);
// How many times faster than real time; max is as fast as the machine goes, with a picture now and then.
const wanted = new URLSearchParams(location.search).get('speed') ?? '1';
const hurry = wanted === 'max';
const pace = hurry ? Infinity : Number(wanted) || 1;

async function file(name) {
  const answer = await fetch(name);
  if (!answer.ok) throw new Error(`${name} is missing (${answer.status})`);
  return answer;
}

async function main() {
  const facts = await (await file('facts.json')).json();
  const models = {
    flat: await (await file('humanoid.xml')).text(),
    uneven: await (await file('humanoid_uneven.xml')).text(),
  };
  const [mujoco, controller] = await Promise.all([
    loadMujoco({ locateFile: (name) => name }),
    file('controller.onnx').then(async (answer) => loadController(new Uint8Array(await answer.arrayBuffer()))),
  ]);

  const stage = new Stage(pick('stage'));
  const readouts = new Readouts(facts);
  let robot = new Robot(mujoco, models.flat, controller, facts);
  stage.show(robot);

  const slider = pick('slider');
  const field = pick('frequency');
  const [lowest, highest] = facts.frequency_range;
  for (const each of [slider, field]) Object.assign(each, { min: lowest, max: highest, step: 0.01 });
  let target = facts.start_frequency;
  let frequency = target;
  const turnTo = (value) => {
    if (Number.isFinite(value)) target = Math.min(Math.max(value, lowest), highest);
    slider.value = target;
    if (document.activeElement !== field || field.valueAsNumber !== target) field.value = target.toFixed(2);
  };
  turnTo(target);
  slider.addEventListener('input', () => turnTo(slider.valueAsNumber));
  field.addEventListener('change', () => turnTo(field.valueAsNumber));
  pick('walk').addEventListener('click', () => turnTo(0.9));
  pick('run').addEventListener('click', () => turnTo(1.3));

  let paused = false;
  const setPaused = (value) => {
    paused = value;
    pick('pause').textContent = paused ? 'Go on' : 'Pause';
  };
  pick('pause').addEventListener('click', () => setPaused(!paused));
  pick('push').addEventListener('click', () => {
    const angle = 2 * Math.PI * Math.random();
    robot.pushWith(PUSH * Math.cos(angle), PUSH * Math.sin(angle));
  });
  pick('reset').addEventListener('click', () => begin(robot.ground.uneven ? 'uneven' : 'flat'));
  for (const each of document.querySelectorAll('input[name=ground]')) {
    each.addEventListener('change', () => begin(each.value));
  }
  let next = null;
  const begin = (ground) => {
    next = ground; // between two control steps
    setPaused(false);
  };

  let downSince = null;
  async function step() {
    const most = facts.turn_rate / facts.control_rate;
    frequency += Math.min(Math.max(target - frequency, -most), most);
    stage.shift(await robot.step(frequency));
    readouts.take(robot);
    downSince = robot.fallen ? (downSince ?? robot.time) : null;
    if (downSince !== null && robot.time - downSince > STOOD_UP_AFTER) {
      robot.restart(frequency);
      readouts.forget();
    }
  }

  function change() {
    robot.free();
    robot = new Robot(mujoco, models[next], controller, facts);
    next = null;
    frequency = target;
    downSince = null;
    readouts.forget();
    stage.show(robot);
  }

  pick('loading').remove();
  let before = performance.now();
  let owed = 0; // simulated time that is due [s]
  let kept = 1; // share of real time that is kept up with
  async function frame() {
    if (next !== null) change();
    const now = performance.now();
    const passed = (now - before) / 1000;
    before = now;
    let done = 0;
    if (!paused) {
      owed = hurry ? 2 : owed + pace * Math.min(passed, 0.25);
      // A machine that is too slow goes slower, and is not choked by what it owes.
      const until = now + (hurry ? 4000 : 60);
      while (owed > 0 && next === null && performance.now() < until) {
        await step();
        owed -= 1 / facts.control_rate;
        done += 1 / facts.control_rate;
      }
      if (!hurry && passed > 0) kept += 0.1 * (Math.min(done / (pace * passed), 2) - kept);
      owed = Math.min(owed, 0.1);
    }
    stage.draw(Math.max(passed, done));
    readouts.show(robot, frequency, hurry || paused ? 1 : kept);
    requestAnimationFrame(frame);
  }
  requestAnimationFrame(frame);
}

main().catch((error) => {
  const note = pick('loading') ?? document.body.appendChild(document.createElement('p'));
  note.id = 'loading';
  note.textContent = `The demo cannot start: ${error.message ?? error}`;
  throw error;
});
