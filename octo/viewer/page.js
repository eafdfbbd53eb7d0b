// The player: it keeps the time, and has the buttons and the keys.

const SPEEDS = [0.05, 0.1, 0.25, 0.5, 1, 2];
const START = icon("M2 2h2v12H2zM14 2v12L5 8z");
const BACK = icon("M11 2v12L2 8zM12 2h2v12h-2z");
const FORWARD = icon("M2 2h2v12H2zM5 2l9 6-9 6z");

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
    const build = () => makeStage(data, array);
    whenBuilt(build, (stage) => {
      this.stage = stage;
      this.show();
    });
    everyFrame((seconds) => {
      if (this.playing && this.stage) this.advance(seconds);
    });
    this.show();
  }

  get time() {
    return Math.min(this.clock, this.end);
  }

  get ready() {
    return this.stage !== null;
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
    listenToKeys(keys);
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
unpacked(octoData.numbers).then((block) => {
  const numbers = new Float32Array(block);
  const array = ([start, length]) => numbers.subarray(start, start + length);
  window.octoPlayer = new Player(octoData, array); // for scripts and tests
});
