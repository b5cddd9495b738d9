// What canvases draw with and listen by.

// A canvas' context with one unit a CSS px, cleared, and its size in these.
function sharp(canvas) {
  const rect = canvas.getBoundingClientRect(), fine = Math.max(1, window.devicePixelRatio || 1);
  const [w, h] = [Math.round(rect.width * fine), Math.round(rect.height * fine)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const context = canvas.getContext("2d");
  context.setTransform(fine, 0, 0, fine, 0, 0);
  context.clearRect(0, 0, rect.width, rect.height);
  return [context, rect.width, rect.height];
}

// Text that can be read on anything.
function written(context, text, x, y, color) {
  context.lineWidth = 3;
  context.lineJoin = "round";
  context.strokeStyle = "rgba(255, 255, 255, 0.9)";
  context.strokeText(text, x, y);
  context.fillStyle = color;
  context.fillText(text, x, y);
}

// Tell clicks from drags: start(x, y), move(dx, dy, event), end(), click(x, y), hover(x, y), leave(), wheel(x, y, factor);
// wheels(event): whether the wheel is meant for the canvas, by default always.
function dragged(canvas, on) {
  let from = null, moved = false, fingers = new Map();
  const at = (event) => {
    const rect = canvas.getBoundingClientRect();
    return [event.clientX - rect.left, event.clientY - rect.top];
  };
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return [Math.hypot(a[0] - b[0], a[1] - b[1]), (a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
  };
  canvas.addEventListener("pointerdown", (event) => {
    fingers.set(event.pointerId, at(event));
    [from, moved] = [at(event), fingers.size > 1];
    try { canvas.setPointerCapture(event.pointerId); } catch { /* an event that no pointer made */ }
    if (on.start && fingers.size === 1) on.start(...from);
  });
  canvas.addEventListener("pointermove", (event) => {
    const [x, y] = at(event);
    if (fingers.size > 1 && fingers.has(event.pointerId)) {
      const [before] = spread();
      fingers.set(event.pointerId, [x, y]);
      const [now, u, v] = spread();
      if (before > 0) on.wheel(u, v, now / before);
    } else if (from === null) {
      if (on.hover) on.hover(x, y);
    } else if (moved || Math.hypot(x - from[0], y - from[1]) > 3) {
      on.move(x - from[0], y - from[1], event);
      [from, moved] = [[x, y], true];
    }
  });
  const done = (event) => {
    const alone = fingers.size === 1;
    fingers.delete(event.pointerId);
    if (from !== null && alone) {
      if (moved) { if (on.end) on.end(); } else if (event.type === "pointerup") on.click(...at(event));
    }
    if (fingers.size === 0) from = null;
  };
  canvas.addEventListener("pointerup", done);
  canvas.addEventListener("pointercancel", done);
  canvas.addEventListener("pointerleave", () => { if (on.leave) on.leave(); });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    if (on.wheels && !on.wheels(event)) return;
    event.preventDefault();
    on.wheel(...at(event), Math.exp(-0.0015 * event.deltaY));
  }, { passive: false });
}
