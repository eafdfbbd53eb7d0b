// The charts: a time line, one row for each contact, the joint torques. Inline SVG, one unit a pixel.

const LEFT = 150; // px, room for names
const RIGHT = 24;
const RULER = 24;
const TITLE = 18;
const PLOT = 104;

function niceStep(range, count) {
  const rough = range / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((m) => m * power).find((step) => step >= rough * (1 - 1e-12));
}

const plain = (value) => String(Number(value.toFixed(9)) || 0); // no 0.30000000000000004, no -0
const shortened = (name) => (name.length > 22 ? `${name.slice(0, 21)}…` : name);
const jointColor = (j, count) =>
  `hsl(${Math.round((360 * j) / count + 210) % 360} 58% ${j % 2 ? 45 : 58}%)`;

// [from, to) of every stretch of ones in a column.
function runs(values, width, column) {
  const found = [];
  const count = values.length / width;
  for (let i = 0; i < count; i++) {
    const from = i;
    while (i < count && values[i * width + column] > 0.5) i++;
    if (i > from) found.push([from, i]);
  }
  return found;
}

class Charts {
  constructor(data, array, end, find) {
    Object.assign(this, { data, array, end, find });
    this.svg = find("chart");
    this.shown = 0; // index of the character whose torques are drawn
    this.chosen = -1; // index of the joint that is drawn alone
    this.width = 1; // px, of the time axis
    this.time = 0;
    this.listJoints();
    let drawn = 0; // drawing changes the height, which the observer sees too
    new ResizeObserver(() => {
      if (this.svg.clientWidth === drawn) return;
      drawn = this.svg.clientWidth;
      this.draw();
    }).observe(this.svg);
  }

  place(t) {
    return LEFT + (this.end > 0 ? (t / this.end) * this.width : 0);
  }

  timeAt(clientX) {
    return ((clientX - this.svg.getBoundingClientRect().left - LEFT) / this.width) * this.end;
  }

  add(kind, attributes, text) {
    const node = document.createElementNS("http://www.w3.org/2000/svg", kind);
    for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
    if (text !== undefined) node.textContent = text;
    this.svg.append(node);
    return node;
  }

  label(y, text, size = 11) {
    const style = `font-size: ${size}px`;
    this.add("text", { x: LEFT - 8, y, "text-anchor": "end", style }, text);
  }

  across(y, kind) {
    this.add("line", { class: kind, x1: LEFT, x2: LEFT + this.width, y1: y, y2: y });
  }

  draw() {
    const width = this.svg.clientWidth;
    this.width = Math.max(width - LEFT - RIGHT, 50);
    this.svg.replaceChildren();
    this.drawRuler();
    const height = this.drawTorques(this.drawStrips(RULER + 4));
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.svg.style.height = `${height}px`;
    this.line = this.add("line", { class: "cursor", y1: 6, y2: height - 2 });
    this.knob = this.add("circle", { class: "knob", cy: 7, r: 6 });
    this.show(this.time);
  }

  drawRuler() {
    this.add("rect", { class: "track", x: LEFT, y: 4, width: this.width, height: 6, rx: 3 });
    this.label(20, "time (s)");
    if (this.end <= 0) return;
    const step = niceStep(this.end, Math.max(this.width / 90, 1));
    for (let t = 0; t <= this.end + 1e-9; t += step)
      this.add("text", { x: this.place(t), y: 22, "text-anchor": "middle" }, plain(t));
  }

  // Each contact's row has a bar for each character. Returns where the next chart begins.
  drawStrips(y) {
    const { characters, loadedFoot } = this.data;
    const names = [...new Set(characters.flatMap((c) => c.contacts))];
    if (!names.length) return y;
    const title = "Contacts under load (a bar while one carries at least 1 % of the weight)";
    this.add("text", { class: "title", x: LEFT, y: y + 12 }, title);
    y += TITLE;
    const row = names.length <= 8 ? 15 : names.length <= 16 ? 12 : 10;
    const height = (row - 4) / characters.length;
    for (const name of names) {
      this.label(y + row / 2 + 3.5, shortened(name), Math.min(row - 1, 11));
      this.across(y + row - 0.5, "grid");
      characters.forEach((c, k) => {
        const column = c.contacts.indexOf(name);
        if (column < 0) return;
        const fill = characters.length > 1 ? c.color : `rgb(${loadedFoot})`;
        for (const [from, to] of runs(this.array(c.contactLoaded), c.contacts.length, column)) {
          const x = this.place(from * c.chartStep);
          const stop = this.place(Math.min(to * c.chartStep, c.end));
          const box = { x, y: y + 2 + k * height, width: Math.max(stop - x, 0.5), height };
          this.add("rect", { class: "loaded", "data-foot": name, fill, ...box });
        }
      });
      y += row;
    }
    return y + 6;
  }

  drawTorques(y) {
    const c = this.data.characters[this.shown];
    const width = c.joints.length;
    if (!width) return y;
    const torque = this.array(c.torque);
    const count = torque.length / width;
    const alone = this.chosen >= 0;
    const whose = this.data.characters.length > 1 ? ` of ${c.label}` : "";
    const units = alone ? [c.units[this.chosen]] : [...new Set(c.units)];
    const words = units.map((unit) => (unit === "N m" ? "torques" : "forces")).join(" and ");
    const what = alone ? c.joints[this.chosen] : `Joint ${words}`;
    const title = `${what}${whose} (${units.join(", ")})`;
    this.add("text", { class: "title", x: LEFT, y: y + 12 }, title);
    y += TITLE + 4;

    const joints = alone ? [this.chosen] : [...c.joints.keys()];
    let low = 0;
    let high = 0;
    for (const j of joints) {
      for (let i = 0; i < count; i++) {
        low = Math.min(low, torque[i * width + j]);
        high = Math.max(high, torque[i * width + j]);
      }
    }
    const limit = alone ? c.limits[this.chosen] : null;
    const near = limit !== null && Math.max(-low, high) > 0.5 * limit; // worth its room
    if (near) [low, high] = [Math.min(low, -1.05 * limit), Math.max(high, 1.05 * limit)];
    const step = niceStep(Math.max(high - low, 1e-9), 4);
    low = Math.floor(low / step) * step;
    high = Math.max(Math.ceil(high / step) * step, low + step);
    const level = (value) => y + (PLOT * (high - value)) / (high - low);
    for (let value = low; value <= high + 1e-9 * step; value += step) {
      this.across(level(value), "grid");
      this.label(level(value) + 4, plain(value));
    }
    for (const side of near ? [-limit, limit] : []) this.across(level(side), "limit");

    const stops = Array.from({ length: count }, (_, i) => Math.min((i + 1) * c.chartStep, c.end));
    const ends = stops.map((t) => this.place(t).toFixed(1));
    for (const j of joints) {
      let d = `M${this.place(0).toFixed(1)} ${level(torque[j]).toFixed(1)}`;
      for (let i = 0; i < count; i++)
        d += `V${level(torque[i * width + j]).toFixed(1)}H${ends[i]}`;
      const stroke = jointColor(j, width);
      this.add("path", { class: "curve", d, stroke, "data-joint": c.joints[j] });
    }
    return y + PLOT + 8;
  }

  // The legend of the torques, with their values at the cursor; a click shows one alone.
  listJoints() {
    const c = this.data.characters[this.shown];
    const list = this.find("joints");
    const entries = c.joints.map((name, j) => {
      const entry = document.createElement("div");
      entry.innerHTML = "<i></i><span></span><b></b>";
      entry.children[0].style.background = jointColor(j, c.joints.length);
      entry.children[1].textContent = name;
      const limit = c.limits[j] === null ? "" : `, limit ${plain(c.limits[j])} ${c.units[j]}`;
      entry.title = `${name}${limit} (click to see it alone)`;
      entry.onclick = () => {
        this.chosen = this.chosen === j ? -1 : j;
        entries.forEach((other, k) => other.classList.toggle("on", k === this.chosen));
        this.draw();
      };
      return entry;
    });
    list.replaceChildren(...entries);
    const tabs = this.find("tabs");
    tabs.hidden = this.data.characters.filter((other) => other.joints.length).length < 2;
    if (tabs.hidden) return;
    const choices = this.data.characters.map((other, k) => {
      const choose = () => {
        this.shown = k;
        this.chosen = -1;
        this.listJoints();
        this.draw();
      };
      return button(other.label, `torques of ${other.label}`, choose, k === this.shown);
    });
    tabs.replaceChildren("Torques of", ...choices);
  }

  show(t) {
    this.time = t;
    this.svg.setAttribute("aria-valuenow", t.toFixed(3));
    if (this.line) {
      const x = this.place(t).toFixed(2);
      this.line.setAttribute("x1", x);
      this.line.setAttribute("x2", x);
      this.knob.setAttribute("cx", x);
    }
    const c = this.data.characters[this.shown];
    const width = c.joints.length;
    if (!width) return;
    const torque = this.array(c.torque);
    const count = torque.length / width;
    // The torque of the step that t is in; a node is the end of the step before it.
    const step = Math.min(Math.max(Math.ceil(t / c.chartStep - 1e-4) - 1, 0), count - 1);
    [...this.find("joints").children].forEach((entry, j) => {
      entry.lastChild.textContent = `${torque[step * width + j].toFixed(2)} ${c.units[j]}`;
    });
  }
}
