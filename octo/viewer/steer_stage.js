// The character and its world in viser's scene.

// A function (walker, {forces, plain}: what is shown, and how); null while viser has not built its nodes yet.
function makeSteerStage(data) {
  const { contacts, arrows, ground, prints, away, plain } = data;
  const bodies = data.bodies.flatMap((name, b) => (name ? [[name, b]] : []));
  const fixed = ["/world", ground.name, prints.name, plain.lines, plain.patch, ...(arrows ? [arrows] : [])];
  const viser = connected([...fixed, ...bodies.map(([name]) => name), ...data.feet]);
  if (!viser) return null;
  const { move, turn, update, visible, changed } = viser;

  // The world moves, so that the camera, which a mouse turns, stays with the character.
  function around({ x, y, yaw }) {
    const near = (edge) => [x, y].map((value) => edge * Math.round(value / edge));
    return [
      move("/world", aboutZ(-yaw, [-x, -y, 0])),
      turn("/world", quaternionAboutZ(-yaw, [1, 0, 0, 0])),
      move(ground.name, [...near(ground.repeats), ground.height]),
      move(plain.lines, [...near(plain.edge), ground.height]),
    ];
  }

  // Without shadows and the plane: a tenth of the work.
  function lookMessages(on) {
    return [
      { type: "EnableLightsMessage", enabled: true, cast_shadow: !on },
      visible(ground.name, !on),
      ...[plain.lines, plain.patch].map((name) => visible(name, on)),
    ];
  }

  // The older, the more a print looks like the ground.
  function printsMessage({ prints: made }) {
    const positions = new Float32Array(3 * prints.count);
    const colors = new Uint8Array(3 * prints.count);
    for (let k = 0; k < prints.count; k++) {
      const own = made[made.length - 1 - k];
      positions.set(own ? [own.x, own.y, ground.height] : [0, 0, away], 3 * k);
      const color = mixed(data.printColor, data.fadedColor, k / prints.count);
      colors.set(color.map(Math.round), 3 * k);
    }
    return update(prints.name, { batched_positions: positions, batched_colors: colors });
  }

  return (walker, { forces, plain: isPlain }) => {
    const posed = data.bodies.map((_, b) => walker.now(b));
    const messages = around(walker.eye);
    if (changed("look", isPlain)) messages.push(...lookMessages(isPlain));
    if (isPlain) {
      const { x, y } = walker.base();
      messages.push(
        move(plain.patch, [x, y, ground.height]),
        turn(plain.patch, quaternionAboutZ(walker.heading, [1, 0, 0, 0])),
      );
    }
    for (const [name, b] of bodies)
      messages.push(turn(name, posed[b][0]), move(name, posed[b][1]));
    const points = new Float32Array(6 * contacts.length);
    contacts.forEach((contact, c) => {
      const force = walker.force(c, walker.step);
      const color = force ? data.loadedFoot : data.foot;
      if (contact.foot && changed(contact.foot, color)) messages.push(update(contact.foot, { color }));
      const from = walker.under(contact, posed[contact.body]);
      const shown = forces && force;
      points.set(shown ? from : [0, 0, away], 6 * c);
      points.set(shown ? from.map((value, k) => value + force[k]) : [0, 0, away - 1], 6 * c + 3);
    });
    if (arrows && (changed(arrows, forces) || forces)) messages.push(update(arrows, { points }));
    if (changed(prints.name, walker.printed)) messages.push(printsMessage(walker));
    viser.send(messages);
  };
}
