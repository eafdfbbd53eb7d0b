// The page with which a character is steered: its clock, its buttons and its keys.

const SPEEDS = [0.25, 0.5, 1];

class Steering {
  constructor(data, numbers) {
    this.data = data;
    this.walker = new Walker(data, numbers);
    this.speed = 1;
    this.playing = true;
    this.forces = false;
    this.plain = drawnBySoftware(); // the look that such a computer can draw in time
    this.wait = 0; // s, from the last choice until it is done
    this.stage = null;
    this.find = (name) => document.querySelector(`[data-octo="${name}"]`);
    this.addButtons();
    this.addKeys();
    const build = () => makeSteerStage(data);
    whenBuilt(build, (stage) => {
      this.stage = stage;
      this.show();
    });
    everyFrame((seconds) => {
      if (this.playing && this.ready) this.advance(seconds * this.speed);
    });
    this.show();
  }

  get ready() {
    return this.stage !== null;
  }

  advance(seconds) {
    this.walker.advance(seconds);
    this.show();
  }

  // Which motion is wanted, by its number.
  choose(motion) {
    this.walker.wanted = motion;
    this.wait = this.walker.plan?.there ?? 0;
    this.show();
  }

  change(name) {
    if (name === "turns") this.walker.turns = !this.walker.turns;
    else this[name] = !this[name];
    this.show();
  }

  addButtons() {
    this.motionButtons = this.data.motions.map(({ name, word }, k) => {
      const node = button(name, `${name} (${word ?? k + 1})`, () => this.choose(k), false);
      const key = document.createElement("kbd");
      key.textContent = word ?? k + 1;
      node.prepend(key, " ");
      node.dataset.motion = name;
      return node;
    });
    this.find("motions").append(...this.motionButtons);
    this.switches = [
      ["playing", "pause", "P"],
      ["forces", "forces", "F"],
      ["turns", "turn with it", "C"],
      ["plain", "plain", "L"],
    ].filter(([name]) => name !== "forces" || this.data.arrows);
    this.switchButtons = this.switches.map(([name, word, key]) => {
      const node = button(`${word} (${key})`, `${word} (${key})`, () => this.change(name), false);
      node.dataset.octo = name;
      return node;
    });
    this.find("switches").append(...this.switchButtons);
    this.speedButtons = SPEEDS.map((value) => {
      const choose = () => {
        this.speed = value;
        this.show();
      };
      return button(`${value}×`, `${value} times real time`, choose, false);
    });
    this.find("speeds").append("speed\u00a0", ...this.speedButtons);
  }

  addKeys() {
    const keys = {};
    const once = (act) => (event) => event.repeat || act();
    for (const [name, , key] of this.switches)
      for (const letter of [key, key.toLowerCase()]) keys[letter] = once(() => this.change(name));
    this.data.motions.forEach(({ key }, k) => {
      for (const own of [String(k + 1), key].filter(Boolean)) keys[own] = once(() => this.choose(k));
    });
    listenToKeys(keys);
  }

  // What it does, and when it will do what is wanted.
  get state() {
    const { walker, data } = this;
    const { piece } = walker;
    const [from, to] = [piece.start, piece.stop].map((node) => data.names[walker.motionOf(node)]);
    const { x, y } = walker.base();
    return {
      clock: walker.clock,
      motion: from === to ? from : `${from} → ${to}`,
      wanted: data.names[walker.wanted],
      plan: walker.plan,
      node: data.nodes[piece.start],
      next: data.nodes[piece.stop],
      time: walker.time,
      x: x + walker.moved.x,
      y: y + walker.moved.y,
      heading: walker.heading,
      prints: walker.prints.length,
    };
  }

  show() {
    const { walker } = this;
    this.stage?.(walker, this);
    const { motion, wanted, plan } = this.state;
    const seconds = (value) => `${value.toFixed(1)} s`;
    const begins = plan?.begins > 0 ? `begins in ${seconds(plan.begins)}, ` : "";
    this.find("now").textContent = motion;
    this.find("next").textContent = plan ? `${wanted}: ${begins}there in ${seconds(plan.there)}` : "";
    const share = plan && this.wait > 0 ? 1 - plan.there / this.wait : 1;
    this.motionButtons.forEach((node, k) => {
      node.setAttribute("aria-pressed", k === walker.wanted);
      node.style.setProperty("--share", k === walker.wanted ? share.toFixed(3) : 0);
    });
    const on = { playing: !this.playing, forces: this.forces, turns: walker.turns, plain: this.plain };
    for (const node of this.switchButtons)
      node.setAttribute("aria-pressed", on[node.dataset.octo]);
    this.speedButtons.forEach((node, k) =>
      node.setAttribute("aria-pressed", SPEEDS[k] === this.speed),
    );
  }
}

const octoData = JSON.parse(document.getElementById("octo-data").textContent);
unpacked(octoData.numbers).then((block) => {
  window.octoSteer = new Steering(octoData, new Int16Array(block)); // for scripts and tests
});
