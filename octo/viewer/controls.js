// What every page has: buttons, keys, and numbers.

const icon = (d) => `<svg viewBox="0 0 16 16" aria-hidden="true"><path d="${d}"/></svg>`;
const PLAY = icon("M3 1.5v13l11-6.5z");
const PAUSE = icon("M3 2h4v12H3zM9 2h4v12H9z");

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

// The block of numbers of the page.
async function unpacked(base64) {
  const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

// Call what ``keys`` has of the key that is pressed, unless something else wants it.
function listenToKeys(keys) {
  const listen = (event) => {
    const inText = event.target.closest?.("input, textarea, select, [contenteditable]");
    const onButton = event.key === " " && event.target.closest?.("button");
    const withOthers = event.ctrlKey || event.metaKey || event.altKey;
    if (inText || onButton || withOthers || !(event.key in keys)) return;
    event.preventDefault();
    event.stopImmediatePropagation(); // viser listens to the space bar too
    keys[event.key](event);
  };
  window.addEventListener("keydown", listen, true);
}

// Call ``advance`` in every frame of the browser with the s since the last one: at most 0.1, so that
// a page that was hidden goes on where it was.
function everyFrame(advance) {
  let before = null;
  const tick = (now) => {
    if (before !== null) advance(Math.min((now - before) / 1000, 0.1));
    before = now;
    requestAnimationFrame(tick);
  };
  requestAnimationFrame(tick);
}

// Call ``done`` with what ``make`` returns, once that is not null any more.
function whenBuilt(make, done, tries = 1200) {
  const made = make();
  if (made) done(made);
  else if (tries > 0) setTimeout(() => whenBuilt(make, done, tries - 1), 50);
  else document.querySelector('[data-octo="notice"]').textContent = "This browser cannot show the scene.";
}
