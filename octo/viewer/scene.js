// A recorded motion at any time, in viser's scene.

// Frame before t, and the share of the way to the next one.
function frameAt(times, t) {
  let low = 0;
  let high = times.length - 1;
  if (high === 0) return [0, 0];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t + 1e-7) low = middle;
    else high = middle;
  }
  return [low, Math.min(Math.max((t - times[low]) / (times[high] - times[low]), 0), 1)];
}

// A soft body's surface X + Σ z_k φ_k.
function bentPoints({ points, modes }, z) {
  const found = Float32Array.from(points);
  z.forEach((value, k) => {
    for (let i = 0; i < found.length; i++) found[i] += value * modes[k * found.length + i];
  });
  return found;
}

// A function (t, lap) that shows that moment; null while viser has not built its nodes yet.
function makeStage(data, array) {
  const characters = data.characters.map((c) => ({
    ...c,
    rotation: array(c.rotation),
    origin: array(c.origin),
    force: array(c.force),
    carries: array(c.carries),
    bent: c.bent && {
      names: c.bent.names,
      points: array(c.bent.points),
      modes: array(c.bent.modes),
      z: array(c.bent.z),
    },
  }));
  const nodes = characters.flatMap((c) => [...c.bodies, ...c.feet, c.arrows]).filter(Boolean);
  const viser = connected(nodes);
  if (!viser) return null;
  const { move, turn, update, changed } = viser;
  const times = array(data.times);
  const shift = array(data.shift);

  // A lap begins where the last one ended: the ground goes back, the world turns with the walker.
  function lapMessages(lap) {
    const { yaw, way } = data.cycle;
    let back = [0, 0, 0];
    for (let k = 0; k < lap; k++) back = aboutZ(-yaw, back.map((value, j) => value - way[j]));
    const ground = data.grounds.flatMap(({ name, position, wxyz }) => [
      move(name, aboutZ(-lap * yaw, position).map((value, j) => value + back[j])),
      turn(name, quaternionAboutZ(-lap * yaw, wxyz)),
    ]);
    return [turn("/world", quaternionAboutZ(lap * yaw, [1, 0, 0, 0])), ...ground];
  }

  return (t, lap) => {
    const [frame, share] = frameAt(times, t);
    const next = Math.min(frame + 1, times.length - 1);
    const step = share > 1e-4 ? next : frame; // forces belong to the step that ends at a frame
    const row = (values, size, width, k, between = mixed) => {
      const at = (f) => values.subarray((f * width + k) * size, (f * width + k + 1) * size);
      return between(at(frame), at(next), share);
    };
    const angle = data.cycle ? lap * data.cycle.yaw : 0;
    const messages = [move("/world", aboutZ(angle, row(shift, 3, 1, 0)).map((value) => -value))];
    if (data.cycle && changed("lap", lap)) messages.push(...lapMessages(lap));
    for (const c of characters) {
      c.bodies.forEach((name, b) => {
        messages.push(turn(name, row(c.rotation, 4, c.bodies.length, b, turned)));
        messages.push(move(name, row(c.origin, 3, c.bodies.length, b)));
      });
      if (c.bent) {
        const vertices = bentPoints(c.bent, row(c.bent.z, c.bent.z.length / times.length, 1, 0));
        messages.push(...c.bent.names.map((name) => update(name, { vertices })));
      }
      c.feet.forEach((name, k) => {
        const loaded = c.carries[step * c.feet.length + k] > 0.5;
        const color = loaded ? data.loadedFoot : data.foot;
        if (changed(name, loaded)) messages.push(update(name, { color }));
      });
      const width = c.force.length / times.length;
      if (c.arrows && changed(c.arrows, step)) {
        const points = c.force.slice(step * width, (step + 1) * width);
        messages.push(update(c.arrows, { points }));
      }
    }
    viser.send(messages);
  };
}
