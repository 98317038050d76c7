// Numbers and the gait diagram beside the picture.

const SPAN = 3; // what the gait diagram shows [s]
const WINDOW = 1.5; // over which the speed is a mean [s]
const FLIGHT = 0.04; // share of the time in the air above which it runs
const COLOURS = ['#e07a3f', '#3f7fbf']; // right, left

export class Readouts {
  constructor(facts) {
    this.facts = facts;
    this.canvas = document.querySelector('#gait');
    this.history = [];
  }

  forget() {
    this.history = [];
  }

  take(robot) {
    this.history.push({ time: robot.time, distance: robot.distance, contacts: robot.contacts() });
    while (robot.time - this.history[0].time > SPAN) this.history.shift();
  }

  show(robot, frequency, pace) {
    const { leg_length: leg, gravity } = this.facts;
    const recent = this.history.filter(({ time }) => robot.time - time <= WINDOW);
    const first = recent[0] ?? { time: robot.time, distance: robot.distance };
    const speed = robot.time > first.time ? (robot.distance - first.distance) / (robot.time - first.time) : 0;
    const flight = recent.filter(({ contacts }) => !contacts[0] && !contacts[1]).length / Math.max(recent.length, 1);
    const begun = robot.time - first.time < 0.9 * WINDOW;
    const gait = begun ? 'Starting' : flight > FLIGHT ? 'Running' : 'Walking';
    const texts = {
      speed: speed.toFixed(2),
      froude: ((speed * speed) / (gravity * leg)).toFixed(2),
      now: frequency.toFixed(2),
      falls: String(robot.falls),
      time: robot.time.toFixed(1),
      distance: robot.distance.toFixed(1),
      name: robot.fallen ? 'Fallen' : gait,
      flight: `${Math.round(100 * flight)} % flight`,
      pace: pace < 0.95 ? `This machine keeps ${Math.round(100 * pace)} % of real time.` : '',
    };
    for (const [name, text] of Object.entries(texts)) document.querySelector(`#${name}`).textContent = text;
    this.diagram(robot.time);
  }

  diagram(now) {
    const ratio = Math.min(window.devicePixelRatio, 2);
    const [width, height] = [this.canvas.clientWidth * ratio, this.canvas.clientHeight * ratio];
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    const context = this.canvas.getContext('2d');
    context.clearRect(0, 0, width, height);
    const step = width / (SPAN * this.facts.control_rate);
    for (const { time, contacts } of this.history) {
      const end = Math.round(width * (1 - (now - time) / SPAN)); // whole pixels, so that no seams are seen
      const x = Math.floor(end - step);
      contacts.forEach((down, foot) => {
        context.fillStyle = down ? COLOURS[foot] : '#e6eaee';
        context.fillRect(x, (foot * height) / 2 + ratio, end - x, height / 2 - 2 * ratio);
      });
    }
  }
}
