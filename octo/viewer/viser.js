// What viser's scene shows.
//
// viser's own player counts in wall time, has no speed below 0.5 and no frames, and replays the
// whole recording for a step backwards. So the recording is the still scene alone, which hides that
// player, and each pose is sent from here as the message a viser server would send, through the
// queue that viser opens to its own browser tests (window.__viserMutable, in viser 1.1.0 and later).

const aboutZ = (angle, [x, y, z]) => {
  const c = Math.cos(angle);
  const s = Math.sin(angle);
  return [c * x - s * y, s * x + c * y, z];
};

const quaternionAboutZ = (angle, [w, x, y, z]) => {
  const c = Math.cos(angle / 2);
  const s = Math.sin(angle / 2);
  return [c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w];
};

// Between two vectors.
function mixed(a, b, share) {
  return Array.from(a, (value, k) => (1 - share) * value + share * b[k]);
}

// Between two quaternions, the shorter way.
function turned(a, b, share) {
  const sign = a.reduce((sum, value, k) => sum + value * b[k], 0) < 0 ? -1 : 1;
  const sum = Array.from(a, (value, k) => (1 - share) * value + sign * share * b[k]);
  const norm = Math.hypot(...sum);
  return sum.map((value) => value / norm);
}

// What sends messages to viser; null while it has not built the nodes of these names yet.
function connected(names) {
  const viser = window.__viserMutable;
  if (!viser?.messageQueue || !viser.nodeRefFromName) return null;
  if (!names.every((name) => viser.nodeRefFromName[name])) return null;
  const sent = new Map(); // for what changes seldom
  return {
    move: (name, position) => ({ type: "SetPositionMessage", name, position, owner: "" }),
    turn: (name, wxyz) => ({ type: "SetOrientationMessage", name, wxyz, owner: "" }),
    update: (name, updates) => ({ type: "SceneNodeUpdateMessage", name, updates, owner: "" }),
    visible: (name, on) => ({ type: "SetSceneNodeVisibilityMessage", name, visible: on }),
    changed: (key, value) => sent.get(key) !== value && Boolean(sent.set(key, value)),
    send(messages) {
      viser.messageQueue.push(...messages);
      viser.requestRender?.(); // 1.1.0 draws all the time and has no such function
    },
  };
}

// Whether the browser draws without a graphics card.
function drawnBySoftware() {
  const gl = document.createElement("canvas").getContext("webgl");
  if (!gl) return true;
  const named = gl.getExtension("WEBGL_debug_renderer_info");
  const name = String(gl.getParameter(named ? named.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}
