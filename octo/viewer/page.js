// The player: it keeps the time, and has the buttons and the keys.

const SPEEDS = [0.05, 0.1, 0.25, 0.5, 1, 2];
const icon = (d) => `<svg viewBox="0 0 16 16" aria-hidden="true"><path d="${d}"/></svg>`;
const PLAY = icon("M3 1.5v13l11-6.5z");
const PAUSE = icon("M3 2h4v12H3zM9 2h4v12H9z");
const START = icon("M2 2h2v12H2zM14 2v12L5 8z");
const BACK = icon("M11 2v12L2 8zM12 2h2v12h-2z");
const FORWARD = icon("M2 2h2v12H2zM5 2l9 6-9 6z");

function button(text, title, press, pressed) {
  const node = document.createElement("button");
  node.type = "button";
  if (text.startsWith("<svg")) node.innerHTML = text;
  else node.textContent = text;
  node.title = title;
  node.setAttribute("aria-label", title);
  if (pressed !== undefined) node.setAttribute("aria-pressed", pressed);
  node.onmousedown = (event) => event.preventDefault(); // a click leaves the keyboard where it is
  node.onclick = press;
  return node;
}

async function unpacked(base64) {
  const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Float32Array(await new Response(stream).arrayBuffer());
}

class Player {
  constructor(data, array) {
    this.data = data;
    this.array = array;
    this.times = array(data.times);
    this.end = this.times[this.times.length - 1];
    this.clock = 0; // s; runs on after the end while the last frame is held
    this.lap = 0; // how many times a cycle has been walked
    this.speed = 1;
    this.playing = true;
    this.repeat = true;
    this.stage = null;
    this.find = (name) => document.querySelector(`[data-octo="${name}"]`);
    this.charts = new Charts(data, array, this.end, this.find);
    this.addButtons();
    this.addKeys();
    this.addDragging();
    this.findStage(1200);
    let before = null;
    const tick = (now) => {
      // At most 0.1 s at once: a page that was hidden goes on where it was.
      if (this.playing && this.stage && before !== null)
        this.advance(Math.min((now - before) / 1000, 0.1));
      before = now;
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
    this.show();
  }

  get time() {
    return Math.min(this.clock, this.end);
  }

  get ready() {
    return this.stage !== null;
  }

  findStage(tries) {
    this.stage = makeStage(this.data, this.array);
    if (this.stage) this.show();
    else if (tries > 0) setTimeout(() => this.findStage(tries - 1), 50);
    else this.find("notice").textContent = "This browser cannot show the scene.";
  }

  seek(t) {
    this.playing = false;
    this.clock = Math.min(Math.max(t, 0), this.end);
    this.show();
  }

  stepFrames(count) {
    const [frame, share] = frameAt(this.times, this.time);
    const place = frame + share;
    const near = Math.round(place);
    // Between two frames, the next one in that direction.
    const from = Math.abs(place - near) < 1e-3 ? near : count > 0 ? frame : frame + 1;
    this.seek(this.times[Math.min(Math.max(from + count, 0), this.times.length - 1)]);
  }

  play(on) {
    this.playing = on;
    if (on && this.clock >= this.end && !this.data.loop) this.clock = 0;
    this.show();
  }

  advance(seconds) {
    this.clock += seconds * this.speed;
    const hold = this.data.loop ? 0 : this.data.hold * this.speed; // s of wall time at every speed
    if (!this.repeat && this.clock >= this.end) {
      this.clock = this.end;
      this.playing = false;
    } else if (this.clock >= this.end + hold) {
      if (this.data.loop) this.lap += Math.floor(this.clock / this.end);
      this.clock = this.data.loop ? this.clock % this.end : 0;
    }
    this.show();
  }

  addButtons() {
    this.playButton = button(PLAY, "play (space)", () => this.play(!this.playing));
    this.playButton.dataset.octo = "play";
    this.find("buttons").append(
      button(START, "to the start (Home)", () => this.seek(0)),
      button(BACK, "one frame back (← or ,)", () => this.stepFrames(-1)),
      this.playButton,
      button(FORWARD, "one frame forward (→ or .)", () => this.stepFrames(1)),
    );
    this.speedButtons = SPEEDS.map((value) => {
      const choose = () => {
        this.speed = value;
        this.show();
      };
      const node = button(`${value}×`, `${value} times real time`, choose, false);
      node.dataset.speed = value;
      return node;
    });
    const change = () => {
      this.repeat = !this.repeat;
      this.show();
    };
    const word = this.data.loop ? "loop" : "repeat";
    this.repeatButton = button(word, "begin anew at the end", change, true);
    this.repeatButton.dataset.octo = "repeat";
    this.find("speeds").append("speed\u00a0", ...this.speedButtons, "\u00a0", this.repeatButton);
  }

  addKeys() {
    const forward = () => this.stepFrames(1);
    const back = () => this.stepFrames(-1);
    const keys = {
      " ": () => this.play(!this.playing),
      ArrowRight: forward,
      ".": forward,
      ArrowLeft: back,
      ",": back,
      Home: () => this.seek(0),
      End: () => this.seek(this.end),
    };
    const listen = (event) => {
      const inText = event.target.closest?.("input, textarea, select, [contenteditable]");
      const onButton = event.key === " " && event.target.closest?.("button");
      const withOthers = event.ctrlKey || event.metaKey || event.altKey;
      if (inText || onButton || withOthers || !(event.key in keys)) return;
      event.preventDefault();
      event.stopImmediatePropagation(); // viser listens to the space bar too
      keys[event.key]();
    };
    window.addEventListener("keydown", listen, true);
  }

  addDragging() {
    const svg = this.charts.svg;
    svg.addEventListener("pointerdown", (event) => {
      svg.setPointerCapture(event.pointerId);
      this.seek(this.charts.timeAt(event.clientX));
    });
    svg.addEventListener("pointermove", (event) => {
      if (svg.hasPointerCapture(event.pointerId)) this.seek(this.charts.timeAt(event.clientX));
    });
  }

  show() {
    this.stage?.(this.time, this.lap);
    this.charts.show(this.time);
    const [frame, share] = frameAt(this.times, this.time);
    this.find("time").textContent = this.time.toFixed(3);
    this.find("frame").textContent = Math.round(frame + share);
    const title = this.playing ? "pause (space)" : "play (space)";
    if (this.playButton.title !== title) {
      this.playButton.innerHTML = this.playing ? PAUSE : PLAY;
      this.playButton.title = title;
      this.playButton.setAttribute("aria-label", title);
    }
    for (const node of this.speedButtons)
      node.setAttribute("aria-pressed", Number(node.dataset.speed) === this.speed);
    this.repeatButton.setAttribute("aria-pressed", this.repeat);
  }
}

const octoData = JSON.parse(document.getElementById("octo-data").textContent);
unpacked(octoData.numbers).then((numbers) => {
  const array = ([start, length]) => numbers.subarray(start, start + length);
  window.octoPlayer = new Player(octoData, array); // for scripts and tests
});
