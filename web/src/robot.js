// One humanoid in MuJoCo and its controller, a control step of 1/60 s at a time, as in examples/stand_alone.py.
import * as ort from 'onnxruntime-web/wasm';
import { Ground } from './ground.js';

ort.env.wasm.numThreads = 1; // threads need headers that a static host may not send
ort.env.wasm.wasmPaths = new URL('.', document.baseURI).href;
ort.env.logLevel = 'error';

const NUM_JOINTS = 28;
const LOWEST = 0.55; // pelvis above the ground [m]; below, or tilted by more than 60 degrees, it has fallen
const PUSH_DURATION = 0.1; // [s]

export const loadController = (bytes) => ort.InferenceSession.create(bytes);

function cross([ax, ay, az], [bx, by, bz]) {
  return [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx];
}

export class Robot {
  constructor(mujoco, xml, controller, facts) {
    Object.assign(this, { mujoco, controller, facts });
    this.model = mujoco.MjModel.from_xml_string(xml);
    this.data = new mujoco.MjData(this.model);
    this.ground = new Ground(this.model);
    this.torso = this.model.body('torso').id;
    this.falls = 0;
    this.time = 0;
    this.distance = 0;
    this.restart(facts.gaits[0].frequency);
  }

  free() {
    this.data.delete();
    this.model.delete();
  }

  // Stand up, in the pose of the imitated gait that is nearest to a stride frequency, where the robot is.
  restart(frequency) {
    const { mujoco, model, data, facts } = this;
    const [x, y] = this.time > 0 ? data.qpos : (this.ground.middle ?? [0, 0]);
    const nearest = facts.gaits.reduce((a, b) =>
      Math.abs(b.frequency - frequency) < Math.abs(a.frequency - frequency) ? b : a,
    );
    mujoco.mj_resetDataKeyframe(model, data, model.key(nearest.name).id);
    const around = [-0.4, -0.2, 0, 0.2, 0.4];
    const heights = around.flatMap((dx) => around.map((dy) => this.ground.height(x + dx, y + dy)));
    data.qpos[0] = x;
    data.qpos[1] = y;
    data.qpos[2] += Math.max(...heights);
    this.phase = 0;
    this.reflexTorque = new Float32Array(NUM_JOINTS);
    this.jointTorque = new Float32Array(NUM_JOINTS);
    this.force = new Float32Array(6);
    this.moment = new Float32Array(6);
    this.pushed = null;
    this.fallen = false;
    mujoco.mj_forward(model, data);
  }

  // Push the torso with a horizontal force [N].
  pushWith(x, y) {
    this.pushed = { force: [x, y, 0], time: this.time };
  }

  async step(frequency) {
    const { mujoco, model, data, facts } = this;
    const qpos = Float32Array.from(data.qpos);
    const qvel = Float32Array.from(data.qvel);
    const inputs = {
      root_position: qpos.slice(0, 3),
      root_rotation: qpos.slice(3, 7),
      root_linear_velocity: qvel.slice(0, 3),
      root_angular_velocity: qvel.slice(3, 6),
      joint_position: qpos.slice(7),
      joint_velocity: qvel.slice(6),
      joint_torque: this.jointTorque,
      foot_force: this.force,
      foot_moment: this.moment,
      ground_height: [this.ground.height(qpos[0], qpos[1])],
      phase: [this.phase],
      frequency: [frequency],
      heading: [0],
      last_reflex_torque: this.reflexTorque,
    };
    const feeds = {};
    for (const [name, values] of Object.entries(inputs)) {
      feeds[name] = new ort.Tensor('float32', Float32Array.from(values), [1, ...facts.shapes[name]]);
    }
    const answer = await this.controller.run(feeds);
    this.phase = answer.next_phase.data[0];
    this.reflexTorque = answer.reflex_torque.data;
    data.ctrl.set(answer.target.data, 0);
    data.ctrl.set(answer.target_velocity.data, NUM_JOINTS);
    data.ctrl.set(this.reflexTorque, 2 * NUM_JOINTS);
    const now = this.pushed !== null && this.time - this.pushed.time < PUSH_DURATION - 0.5 / facts.control_rate;
    data.xfrc_applied.set(now ? this.pushed.force : [0, 0, 0], 6 * this.torso);
    this.force = new Float32Array(6);
    this.moment = new Float32Array(6);
    const before = qpos[0];
    for (let i = 0; i < facts.substeps; i++) {
      mujoco.mj_step(model, data);
      this.addContacts();
    }
    this.jointTorque = Float32Array.from(data.sensordata.slice(24, 24 + NUM_JOINTS));
    this.time += 1 / facts.control_rate;
    this.distance += data.qpos[0] - before;
    this.judge();
    return this.moveOn();
  }

  // Of each foot: its force on the ground, the moment of that about a point, the point, the foot's origin.
  addContacts() {
    const sensors = this.data.sensordata;
    for (const foot of [0, 1]) {
      const [force, moment, point, origin] = [0, 3, 6, 9].map((at) => sensors.slice(12 * foot + at, 12 * foot + at + 3));
      const turned = cross(point.map((each, axis) => each - origin[axis]), force);
      for (let axis = 0; axis < 3; axis++) {
        this.force[3 * foot + axis] -= force[axis] / this.facts.substeps;
        this.moment[3 * foot + axis] -= (moment[axis] + turned[axis]) / this.facts.substeps;
      }
    }
  }

  judge() {
    const [x, y, z, , qx, qy] = this.data.qpos;
    const up = 1 - 2 * (qx * qx + qy * qy);
    const fallen = !(z - this.ground.height(x, y) > LOWEST && up > 0.5);
    if (fallen && !this.fallen) this.falls += 1;
    this.fallen = fallen;
  }

  // Go on a period back where the ground repeats itself; gives the shift [m].
  moveOn() {
    const { qpos } = this.data;
    const shift = this.ground.shift(qpos[0], qpos[1]);
    qpos[0] += shift[0];
    qpos[1] += shift[1];
    return shift;
  }

  // Whether the right and the left foot carry something.
  contacts() {
    return [this.force[2] > 20, this.force[5] > 20];
  }
}
