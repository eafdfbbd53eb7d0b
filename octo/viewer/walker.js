// The character on its way through the graph: which piece it is in, and where that one is laid.
//
// A piece is an edge of the graph, as seen from where the base stands and heads at its start. The
// next one is laid where it ends. What follows is in a table: for each node, and each motion that
// may be wanted, a piece.

const CALM = 0.25; // s, in which the camera follows
const FAR = 40; // repeats of the ground, after which all is moved back: numbers stay small

const rotated = ([w, x, y, z], [a, b, c]) => {
  const u = 2 * (y * c - z * b);
  const v = 2 * (z * a - x * c);
  const t = 2 * (x * b - y * a);
  return [a + w * u + y * t - z * v, b + w * v + z * u - x * t, c + w * t + x * v - y * u];
};

// Rows of poses and of forces of each piece; the differences from row to row are summed.
function unfolded(data, numbers) {
  const width = 7 * data.bodies.length;
  const each = 3 * data.contacts.length;
  let offset = 0;
  return data.pieces.map((piece) => {
    const steps = piece.frames - 1;
    const poses = numbers.subarray(offset, offset + piece.frames * width);
    for (let i = width; i < poses.length; i++) poses[i] += poses[i - width];
    offset += poses.length;
    const forces = numbers.subarray(offset, offset + steps * each);
    offset += forces.length;
    return { ...piece, poses, forces, steps, seconds: steps * data.frame };
  });
}

class Walker {
  constructor(data, numbers) {
    this.data = data;
    this.pieces = unfolded(data, numbers);
    this.wanted = data.nodes[data.start][0];
    this.clock = 0; // s, since the start
    this.place = { yaw: 0, x: 0, y: 0 }; // of the piece
    this.moved = { x: 0, y: 0 }; // m, by which all was moved back
    this.prints = []; // {x, y}, the newest last
    this.printed = 0; // counts changes of them
    this.carried = data.contacts.map(() => false);
    this.turns = false; // whether the camera turns with the character
    this.enter(this.follower(data.start));
    this.eye = { ...this.base(), yaw: 0 };
    this.leavePrints();
  }

  motionOf(node) {
    return this.data.nodes[node][0];
  }

  follower(node) {
    return this.pieces[this.data.next[node][this.wanted]];
  }

  enter(piece) {
    this.piece = piece;
    this.time = 0; // s, since the start of the piece
    this.done = 0; // frames of it whose feet have left their prints
  }

  advance(seconds) {
    for (let left = seconds; left > 0; ) {
      const part = Math.min(left, this.piece.seconds - this.time);
      this.time += part;
      this.clock += part;
      left -= part;
      this.leavePrints();
      if (this.time < this.piece.seconds - 1e-9) break;
      this.goOn();
    }
    this.look(seconds);
  }

  // Into the piece that follows, which lies where this one ends.
  goOn() {
    const [yaw, x, y] = this.piece.end;
    const [east, north] = this.laid([x, y, 0]);
    this.place = { yaw: this.place.yaw + yaw, x: east, y: north };
    this.enter(this.follower(this.piece.stop));
    const { repeats } = this.data.ground;
    for (const axis of ["x", "y"]) {
      if (Math.abs(this.place[axis]) < FAR * repeats) continue;
      const way = repeats * Math.round(this.place[axis] / repeats);
      this.moved[axis] += way;
      for (const point of [this.place, this.eye, ...this.prints]) point[axis] -= way;
      this.printed += 1;
    }
  }

  // A point of the piece, where the piece is laid.
  laid(point) {
    const [x, y, z] = aboutZ(this.place.yaw, point);
    return [x + this.place.x, y + this.place.y, z];
  }

  // Quaternion and origin of a body, at a frame of the piece, not laid yet.
  pose(body, frame) {
    const { grains, bodies } = this.data;
    const row = 7 * bodies.length * frame;
    const { poses } = this.piece;
    const turn = row + 4 * body;
    const origin = row + 4 * bodies.length + 3 * body;
    return [
      Array.from(poses.subarray(turn, turn + 4), (value) => value * grains.rotation),
      Array.from(poses.subarray(origin, origin + 3), (value) => value * grains.origin),
    ];
  }

  // Quaternion and origin of a body now.
  now(body) {
    const place = Math.min(this.time / this.data.frame, this.piece.steps);
    const frame = Math.min(Math.floor(place + 1e-6), this.piece.steps - 1);
    const [one, other] = [this.pose(body, frame), this.pose(body, frame + 1)];
    const turn = turned(one[0], other[0], place - frame);
    const origin = mixed(one[1], other[1], place - frame);
    return [quaternionAboutZ(this.place.yaw, turn), this.laid(origin)];
  }

  base() {
    const [x, y] = this.now(this.data.base)[1];
    return { x, y };
  }

  // The step that time is in: forces belong to the frame that ends it.
  get step() {
    const step = Math.ceil(this.time / this.data.frame - 1e-6) - 1;
    return Math.min(Math.max(step, 0), this.piece.steps - 1);
  }

  // Of a contact in a step of the piece: the arrow of its force (m), null where it carries nothing.
  force(contact, step) {
    const at = 3 * (step * this.data.contacts.length + contact);
    const part = this.piece.forces.subarray(at, at + 3);
    if (!part.some((value) => value !== 0)) return null;
    const length = this.data.grains.force * this.data.arrowLength;
    return aboutZ(this.place.yaw, Array.from(part, (value) => value * length));
  }

  // The lowest point of a contact whose body has such a pose.
  under({ position, radius }, [turn, origin]) {
    const [x, y, z] = rotated(turn, position);
    return [origin[0] + x, origin[1] + y, origin[2] + z - radius];
  }

  // A print wherever a foot begins to carry, up to now.
  leavePrints() {
    const now = Math.floor(this.time / this.data.frame + 1e-6);
    for (; this.done < now; this.done++) {
      this.data.contacts.forEach((contact, c) => {
        const carries = this.force(c, this.done) !== null;
        if (carries && !this.carried[c]) {
          const [x, y] = this.laid(this.under(contact, this.pose(contact.body, this.done + 1)));
          this.print(x, y);
        }
        this.carried[c] = carries;
      });
    }
  }

  print(x, y) {
    const { apart, count } = this.data.prints;
    this.prints = this.prints.filter((own) => Math.hypot(own.x - x, own.y - y) > apart);
    this.prints.push({ x, y });
    if (this.prints.length > count) this.prints.shift();
    this.printed += 1;
  }

  get heading() {
    return this.place.yaw + (this.piece.end[0] * this.time) / this.piece.seconds;
  }

  // The camera goes after the base; it turns with it, or back to where it looked from.
  look(seconds) {
    const share = 1 - Math.exp(-seconds / CALM);
    const { x, y } = this.base();
    const full = 2 * Math.PI;
    const turn = (this.turns ? this.heading : 0) - this.eye.yaw;
    this.eye.x += share * (x - this.eye.x);
    this.eye.y += share * (y - this.eye.y);
    this.eye.yaw += (1 - Math.exp(-seconds / (2 * CALM))) * (turn - full * Math.round(turn / full));
  }

  // When the motion that is wanted begins to be reached and when it is, s from now; null while it
  // is what the character does.
  get plan() {
    let { piece } = this;
    if ([piece.start, piece.stop].every((node) => this.motionOf(node) === this.wanted)) return null;
    let begins = 0;
    let there = piece.seconds - this.time;
    while (this.motionOf(piece.stop) !== this.wanted) {
      begins = there;
      piece = this.follower(piece.stop);
      there += piece.seconds;
    }
    return { begins, there };
  }
}
