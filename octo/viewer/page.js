// The player of the page: it keeps the time, draws the charts, and tells viser's scene what to show.
//
// viser's own player counts in wall time, has no speed below 0.5 and no frames, and sends the whole recording again for every
// step backwards. So the recording is the still scene alone, which hides that player, and each pose is sent from here as the
// message a viser server would send, through the queue that viser shows its own browser tests (window.__viserMutable).
"use strict";
(async () => {
  const data = JSON.parse(document.getElementById("octo-data").textContent);
  const SPEEDS = [0.05, 0.1, 0.25, 0.5, 1, 2];
  const numbers = await unpacked(data.numbers);
  const times = array(data.times);
  const last = times.length - 1, end = times[last];
  const chart = document.querySelector(".octo-chart");
  const find = (name) => document.querySelector(`[data-octo="${name}"]`);

  let clock = 0; // s; runs on through the hold after the end
  let playing = true, speed = 1, repeat = true;
  let lap = 0; // how many times a cycle has been walked
  let stage = null; // viser's side, once it is there
  let shownCharacter = 0, chosenJoint = -1;
  const time = () => Math.min(clock, end);

  async function unpacked(base64) {
    const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
    const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Float32Array(await new Response(plain).arrayBuffer());
  }
  function array(place) { return numbers.subarray(place[0], place[0] + place[1]); }

  // -- time ---------------------------------------------------------------------------------------------------------

  // Frame and share of the way to the next one.
  function frameAt(t) {
    let low = 0, high = last;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] <= t + 1e-7) low = middle; else high = middle;
    }
    return last === 0 ? [0, 0] : [low, Math.min(Math.max((t - times[low]) / (times[high] - times[low]), 0), 1)];
  }
  // Forces and torques belong to the step that ends at x_i: this is the frame (or step) that t is on the way to.
  const stepAt = (t, dt, count) => Math.min(Math.max(Math.ceil(t / dt - 1e-4) - 1, 0), count - 1);

  function seek(t) {
    playing = false;
    clock = Math.min(Math.max(t, 0), end);
    show();
  }
  function stepFrames(count) {
    const [frame, share] = frameAt(time());
    const near = share < 1e-3 ? frame : share > 1 - 1e-3 ? frame + 1 : count > 0 ? frame : frame + 1;
    seek(times[Math.min(Math.max(near + count, 0), last)]);
  }
  function play(on) {
    playing = on;
    if (on && clock >= end && !repeat) clock = 0;
    show();
  }
  function advance(seconds) {
    clock += seconds * speed;
    const hold = data.loop ? 0 : data.hold * speed; // of wall time, at every speed
    if (!repeat && clock >= end) { clock = end; playing = false; }
    else if (clock >= end + hold) {
      if (data.loop && end > 0) { lap += Math.floor(clock / end); clock %= end; } else clock = 0;
    }
  }
  let before = null;
  function tick(now) {
    if (playing && stage && before !== null) { advance(Math.min((now - before) / 1000, 0.1)); show(); }
    before = now;
    requestAnimationFrame(tick);
  }

  // -- scene --------------------------------------------------------------------------------------------------------

  const turned = (angle, [x, y, z]) => {
    const c = Math.cos(angle), s = Math.sin(angle);
    return [c * x - s * y, s * x + c * y, z];
  };
  const turnedPose = (angle, [w, x, y, z]) => {
    const c = Math.cos(angle / 2), s = Math.sin(angle / 2);
    return [c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w];
  };

  function stageOf(viser) {
    const names = data.characters.flatMap((c) => [...c.bodies, ...c.feet, ...(c.arrows ? [c.arrows] : [])]);
    if (!names.every((name) => viser.nodeRefFromName[name])) return null;
    const shown = new Map(); // what was last sent, for what changes seldom
    const move = (name, position) => ({ type: "SetPositionMessage", name, position, owner: "" });
    const turn = (name, wxyz) => ({ type: "SetOrientationMessage", name, wxyz, owner: "" });
    const update = (name, updates) => ({ type: "SceneNodeUpdateMessage", name, updates, owner: "" });
    const changed = (key, value) => shown.get(key) !== value && Boolean(shown.set(key, value));
    const characters = data.characters.map((c) => ({
      ...c, rotation: array(c.rotation), origin: array(c.origin), force: array(c.force), carries: array(c.carries),
    }));
    const shift = array(data.shift);

    function between(values, width, row, frame, share, length) {
      const at = (f) => values.subarray((f * width + row) * length, (f * width + row + 1) * length);
      const a = at(frame), b = at(Math.min(frame + 1, last));
      const sign = length === 4 && a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] < 0 ? -1 : 1;
      const mixed = Array.from(a, (value, k) => (1 - share) * value + sign * share * b[k]);
      const norm = length === 4 ? Math.hypot(...mixed) : 1;
      return mixed.map((value) => value / norm);
    }
    // Later laps go on where the last one ended: the ground goes back instead, and the world turns with the walker.
    function ground() {
      const { yaw, way } = data.cycle;
      let moved = [0, 0, 0];
      for (let k = 0; k < lap; k++) moved = turned(-yaw, moved.map((v, j) => v - way[j]));
      return data.grounds.flatMap((g) => [
        move(g.name, turned(-lap * yaw, g.position).map((v, j) => v + moved[j])), turn(g.name, turnedPose(-lap * yaw, g.wxyz)),
      ]);
    }
    return function draw(t) {
      const [frame, share] = frameAt(t);
      const step = share > 1e-4 ? Math.min(frame + 1, last) : frame;
      const messages = [];
      const angle = data.cycle ? lap * data.cycle.yaw : 0;
      messages.push(move("/world", turned(angle, between(shift, 1, 0, frame, share, 3)).map((v) => -v)));
      if (data.cycle && changed("lap", lap)) messages.push(turn("/world", turnedPose(angle, [1, 0, 0, 0])), ...ground());
      for (const c of characters) {
        c.bodies.forEach((name, b) => messages.push(
          turn(name, between(c.rotation, c.bodies.length, b, frame, share, 4)),
          move(name, between(c.origin, c.bodies.length, b, frame, share, 3))));
        c.feet.forEach((name, k) => {
          const loaded = c.carries[step * c.feet.length + k] > 0.5;
          if (changed(name, loaded)) messages.push(update(name, { color: loaded ? data.loadedFoot : data.foot }));
        });
        const width = c.force.length / times.length;
        if (c.arrows && changed(c.arrows, step))
          messages.push(update(c.arrows, { points: c.force.slice(step * width, (step + 1) * width) }));
      }
      viser.messageQueue.push(...messages);
      viser.requestRender?.(); // viser 1.1.0 draws all the time and has no such function
    };
  }
  function findStage(tries) {
    const viser = window.__viserMutable;
    stage = viser?.messageQueue && viser.nodeRefFromName ? stageOf(viser) : null;
    if (stage) show();
    else if (tries > 0) setTimeout(() => findStage(tries - 1), 50);
    else find("notice").textContent = "The scene cannot be played: this browser, or this version of viser, does not offer what octo needs.";
  }

  // -- charts -------------------------------------------------------------------------------------------------------

  const LEFT = 150, RIGHT = 24, RULER = 24, TITLE = 18, PLOT = 104;
  let cursor = null, plotWidth = 1;
  const place = (t) => LEFT + (end > 0 ? (t / end) * plotWidth : 0);

  function draw(kind, attributes, text) {
    const node = document.createElementNS("http://www.w3.org/2000/svg", kind);
    for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
    if (text !== undefined) node.textContent = text;
    chart.append(node);
    return node;
  }
  function niceStep(range, count) {
    const rough = range / count, power = 10 ** Math.floor(Math.log10(rough));
    return [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough - 1e-12);
  }
  const plain = (value) => String(Number(value.toFixed(9)) || 0); // no 0.30000000000000004, no -0

  function drawCharts() {
    const width = chart.clientWidth;
    plotWidth = Math.max(width - LEFT - RIGHT, 50);
    chart.replaceChildren();
    drawRuler();
    let y = drawStrips(RULER + 4);
    y = drawTorques(y);
    chart.setAttribute("viewBox", `0 0 ${width} ${y}`);
    chart.style.height = `${y}px`;
    cursor = [draw("line", { class: "cursor", y1: 6, y2: y - 2 }), draw("circle", { class: "knob", cy: 7, r: 6 })];
    showCharts();
  }
  function drawRuler() {
    draw("rect", { class: "track", x: LEFT, y: 4, width: plotWidth, height: 6, rx: 3 });
    draw("text", { x: LEFT - 8, y: 20, "text-anchor": "end" }, "time (s)");
    if (end <= 0) return;
    const step = niceStep(end, Math.max(plotWidth / 90, 1));
    for (let t = 0; t <= end + 1e-9; t += step) draw("text", { x: place(t), y: 22, "text-anchor": "middle" }, plain(t));
  }
  function drawStrips(y) {
    const names = [...new Set(data.characters.flatMap((c) => c.contacts))];
    if (!names.length) return y;
    draw("text", { class: "title", x: LEFT, y: y + 12 }, "Loaded feet (a bar while a foot carries at least 1 % of the weight)");
    y += TITLE;
    const row = names.length <= 8 ? 15 : names.length <= 16 ? 12 : 9;
    const several = data.characters.length;
    for (const name of names) {
      draw("text", { x: LEFT - 8, y: y + row / 2 + 4, "text-anchor": "end" }, shortened(name));
      draw("line", { class: "grid", x1: LEFT, x2: LEFT + plotWidth, y1: y + row - 0.5, y2: y + row - 0.5 });
      data.characters.forEach((c, k) => {
        const column = c.contacts.indexOf(name);
        if (column < 0) return;
        const height = (row - 4) / several, color = several > 1 ? c.color : `rgb(${data.loadedFoot})`;
        for (const [from, to] of runs(array(c.contactLoaded), c.contacts.length, column)) {
          const x = place(from * c.chartStep), stop = place(Math.min(to * c.chartStep, c.end));
          draw("rect", { class: "loaded", "data-foot": name, x, y: y + 2 + k * height, width: Math.max(stop - x, 0.5), height, fill: color });
        }
      });
      y += row;
    }
    return y + 6;
  }
  function shortened(name) { return name.length > 22 ? `${name.slice(0, 21)}…` : name; }
  // [from, to) in steps, of every stretch of ones in a column.
  function runs(values, width, column) {
    const found = [];
    const count = values.length / width;
    for (let i = 0; i < count; i++) {
      if (values[i * width + column] < 0.5) continue;
      let j = i;
      while (j < count && values[j * width + column] > 0.5) j++;
      found.push([i, j]);
      i = j;
    }
    return found;
  }
  function drawTorques(y) {
    const c = data.characters[shownCharacter];
    if (!c.joints.length) return y;
    const torque = array(c.torque), width = c.joints.length, count = torque.length / width;
    const whose = data.characters.length > 1 ? ` of ${c.label}` : "";
    const what = chosenJoint >= 0 ? `Torque at ${c.joints[chosenJoint]}` : "Joint torques";
    const unit = chosenJoint >= 0 ? c.units[chosenJoint] : [...new Set(c.units)].join(", ");
    draw("text", { class: "title", x: LEFT, y: y + 12 }, `${what}${whose} (${unit})`);
    y += TITLE + 4;
    const chosen = chosenJoint >= 0 ? [chosenJoint] : [...c.joints.keys()];
    const limit = chosenJoint >= 0 ? c.limits[chosenJoint] : null;
    let low = 0, high = 0;
    for (const j of chosen)
      for (let i = 0; i < count; i++) {
        low = Math.min(low, torque[i * width + j]);
        high = Math.max(high, torque[i * width + j]);
      }
    const near = limit !== null && Math.max(-low, high) > 0.5 * limit; // the limit is worth its room
    if (near) [low, high] = [Math.min(low, -1.05 * limit), Math.max(high, 1.05 * limit)];
    const step = niceStep(Math.max(high - low, 1e-9), 4);
    low = Math.floor(low / step) * step;
    high = Math.max(Math.ceil(high / step) * step, low + step);
    const level = (value) => y + PLOT * (high - value) / (high - low);
    for (let v = low; v <= high + 1e-9 * step; v += step) {
      draw("line", { class: "grid", x1: LEFT, x2: LEFT + plotWidth, y1: level(v), y2: level(v) });
      draw("text", { x: LEFT - 8, y: level(v) + 4, "text-anchor": "end" }, plain(v));
    }
    for (const side of near ? [-limit, limit] : [])
      draw("line", { class: "limit", x1: LEFT, x2: LEFT + plotWidth, y1: level(side), y2: level(side) });
    for (const j of chosen) {
      let path = `M${place(0).toFixed(1)} ${level(torque[j]).toFixed(1)}`;
      for (let i = 0; i < count; i++)
        path += `V${level(torque[i * width + j]).toFixed(1)}H${place(Math.min((i + 1) * c.chartStep, c.end)).toFixed(1)}`;
      draw("path", { class: "curve", d: path, stroke: jointColor(j, width), "data-joint": c.joints[j] });
    }
    return y + PLOT + 8;
  }
  const jointColor = (j, count) => `hsl(${Math.round((360 * j) / count + 210) % 360} 58% ${j % 2 ? 45 : 58}%)`;

  function drawJoints() {
    const c = data.characters[shownCharacter], box = find("joints");
    box.replaceChildren(...c.joints.map((name, j) => {
      const entry = document.createElement("div");
      entry.innerHTML = "<i></i><span></span><b></b>";
      entry.children[0].style.background = jointColor(j, c.joints.length);
      entry.children[1].textContent = name;
      entry.title = `${name}${c.limits[j] === null ? "" : `, limit ${plain(c.limits[j])} ${c.units[j]}`} (click to see it alone)`;
      entry.onclick = () => {
        chosenJoint = chosenJoint === j ? -1 : j;
        [...box.children].forEach((other, k) => other.classList.toggle("on", k === chosenJoint));
        drawCharts();
      };
      return entry;
    }));
    const tabs = find("tabs");
    if (data.characters.filter((other) => other.joints.length).length > 1)
      tabs.replaceChildren("Torques of", ...data.characters.map((other, k) => button(other.label, other.label, () => {
        shownCharacter = k;
        chosenJoint = -1;
        drawJoints();
        drawCharts();
      }, k === shownCharacter)));
    tabs.hidden = !tabs.childElementCount;
  }

  // -- controls -----------------------------------------------------------------------------------------------------

  function button(text, label, press, pressed) {
    const node = document.createElement("button");
    node.type = "button";
    if (text.startsWith("<svg")) node.innerHTML = text; else node.textContent = text;
    node.setAttribute("aria-label", label);
    node.title = label;
    if (pressed !== undefined) node.setAttribute("aria-pressed", pressed);
    node.onmousedown = (event) => event.preventDefault(); // the mouse leaves the focus, and so the keys, where they are
    node.onclick = press;
    return node;
  }
  const icon = (path) => `<svg viewBox="0 0 16 16" aria-hidden="true"><path d="${path}"/></svg>`;
  const PLAY = icon("M3 1.5v13l11-6.5z"), PAUSE = icon("M3 2h4v12H3zM9 2h4v12H9z");
  const playButton = button(PLAY, "play (space)", () => play(!playing));
  playButton.dataset.octo = "play";
  find("buttons").append(
    button(icon("M2 2h2v12H2zM14 2v12L5 8z"), "to the start (Home)", () => seek(0)),
    button(icon("M11 2v12L2 8zM12 2h2v12h-2z"), "one frame back (← or ,)", () => stepFrames(-1)),
    playButton,
    button(icon("M2 2h2v12H2zM5 2l9 6-9 6z"), "one frame forward (→ or .)", () => stepFrames(1)),
  );
  find("speeds").append("speed\u00a0", ...SPEEDS.map((value) => {
    const node = button(`${value}×`, `${value} times real time`, () => { speed = value; showControls(); }, value === speed);
    node.dataset.speed = value;
    return node;
  }));
  const repeatButton = button(data.loop ? "loop" : "repeat", "begin anew at the end", () => { repeat = !repeat; showControls(); }, true);
  repeatButton.dataset.octo = "repeat";
  find("speeds").append("\u00a0", repeatButton);

  const KEYS = {
    " ": () => play(!playing), ArrowRight: () => stepFrames(1), ".": () => stepFrames(1), ArrowLeft: () => stepFrames(-1),
    ",": () => stepFrames(-1), Home: () => seek(0), End: () => seek(end),
  };
  window.addEventListener("keydown", (event) => {
    const inText = event.target.closest?.("input, textarea, select, [contenteditable]");
    const onButton = event.key === " " && event.target.closest?.("button");
    if (inText || onButton || event.ctrlKey || event.metaKey || event.altKey || !(event.key in KEYS)) return;
    event.preventDefault();
    event.stopImmediatePropagation(); // viser listens to the space bar too
    KEYS[event.key]();
  }, true);
  const seekTo = (event) => seek(((event.clientX - chart.getBoundingClientRect().left - LEFT) / plotWidth) * end);
  chart.addEventListener("pointerdown", (event) => {
    chart.setPointerCapture(event.pointerId);
    seekTo(event);
  });
  chart.addEventListener("pointermove", (event) => { if (chart.hasPointerCapture(event.pointerId)) seekTo(event); });

  function showControls() {
    const label = playing ? "pause (space)" : "play (space)";
    if (playButton.title !== label) {
      playButton.innerHTML = playing ? PAUSE : PLAY;
      playButton.title = label;
      playButton.setAttribute("aria-label", label);
    }
    document.querySelectorAll("[data-speed]").forEach((node) => node.setAttribute("aria-pressed", Number(node.dataset.speed) === speed));
    repeatButton.setAttribute("aria-pressed", repeat);
  }
  function showCharts() {
    const t = time(), [frame, share] = frameAt(t);
    if (cursor) {
      const x = place(t).toFixed(2);
      cursor[0].setAttribute("x1", x);
      cursor[0].setAttribute("x2", x);
      cursor[1].setAttribute("cx", x);
    }
    find("time").textContent = t.toFixed(3);
    find("frame").textContent = Math.round(frame + share);
    chart.setAttribute("aria-valuenow", t.toFixed(3));
    const c = data.characters[shownCharacter], width = c.joints.length;
    if (!width) return;
    const torque = array(c.torque), row = stepAt(t, c.chartStep, torque.length / width) * width;
    [...find("joints").children].forEach((entry, j) => {
      entry.lastChild.textContent = `${torque[row + j].toFixed(2)} ${c.units[j]}`;
    });
  }
  function show() {
    stage?.(time());
    showControls();
    showCharts();
  }

  drawJoints();
  showControls();
  let drawnWidth = 0; // drawing changes the height, which the observer sees too
  new ResizeObserver(() => {
    if (chart.clientWidth === drawnWidth) return;
    drawnWidth = chart.clientWidth;
    drawCharts();
  }).observe(chart);
  findStage(1200);
  requestAnimationFrame(tick);
  window.octoPage = { time, seek, play, end, times, lap: () => lap, ready: () => stage !== null }; // for scripts and tests
})();
