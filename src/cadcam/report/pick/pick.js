// Corners of the model, each with its place in the photo; kept by the browser until they are saved as a points file.

const element = (id) => document.getElementById(id);
const told = JSON.parse(element("told").textContent);
const corners = told.corners; // [X, Y, Z] mm
const normals = numbers(told.normals, Float32Array); // 3 of each side of each edge
const picks = new Map(); // corner -> [x, y] px
let active = -1;
let fitted = { why: "" };

const model = new ModelPane(element("model"), {
  vertices: numbers(told.vertices, Float32Array),
  faces: numbers(told.faces, Uint32Array),
  edges: numbers(told.edges, Uint32Array),
  corners: numbers(told.placed, Float32Array),
  said: (k) => `${told.names[k]}   X ${shown(corners[k][0])}   Y ${shown(corners[k][1])}   Z ${shown(corners[k][2])} mm`,
}, choose);
const photo = new PhotoPane(element("photo"), element("picture"), place, put);

function shown(value) { return Number(value.toFixed(told.decimals)).toString(); }

function choose(corner) {
  active = corner;
  if (!picks.has(corner) && fitted.project) {
    const at = fitted.project(corners[corner]);
    if (at !== null) photo.lookAt(...at);
  } else if (picks.has(corner)) {
    photo.lookAt(...picks.get(corner));
  }
  refresh();
}

function place(x, y) {
  if (active < 0) { refresh("First click a corner of the model, then its place in the photo."); return; }
  put(active, x, y);
}

function put(corner, x, y) {
  const { naturalWidth: w, naturalHeight: h } = element("picture");
  if (!(x > -0.5 && y > -0.5 && x < w - 0.5 && y < h - 0.5)) { refresh("That is outside of the photo."); return; }
  picks.set(corner, [x, y].map((value) => Math.round(100 * value) / 100));
  active = corner;
  keep();
  refresh();
}

function remove(corner) {
  picks.delete(corner);
  if (active === corner) active = -1;
  keep();
  refresh();
}

function refresh(message = "") {
  const chosen = [...picks.keys()];
  fitted = fitCamera(chosen.map((k) => corners[k]), chosen.map((k) => picks.get(k)));
  model.active = active;
  model.marks = new Map(chosen.map((k) => [k, told.names[k]]));
  photo.marks = chosen.map((k) => ({ corner: k, name: told.names[k], x: picks.get(k)[0], y: picks.get(k)[1], active: k === active }));
  const ghost = active >= 0 && !picks.has(active) && fitted.project ? fitted.project(corners[active]) : null;
  if (ghost !== null) photo.marks.push({ name: "", x: ghost[0], y: ghost[1], active: true, ghost: true });
  photo.lines = element("lines").checked && fitted.project ? projectedEdges() : [];
  model.show();
  photo.show();
  element("status").textContent = message || advice(chosen);
  table(chosen);
}

function advice(chosen) {
  const next = active < 0
    ? "Click a corner of the model."
    : picks.has(active)
      ? `${told.names[active]}: drag it, or move it by arrow keys (0.1 px; with Shift 1 px). Then click the next corner.`
      : `Click ${told.names[active]} in the photo; zoom in with the wheel.`;
  if (fitted.why) return `${next} ${chosen.length} picked, ${fitted.why}.`;
  const worst = told.names[chosen[fitted.off.indexOf(Math.max(...fitted.off))]];
  const few = chosen.length < 8 ? " With eight or more a wrong pick shows." : "";
  return `${next} ${chosen.length} picked; a camera without lens distortion meets them to ${fitted.rms.toFixed(2)} px (rms), ${worst} worst.${few}`;
}

function table(chosen) {
  element("rows").replaceChildren(...chosen.map((k, row) => {
    const cells = [told.names[k], ...corners[k].map(shown), ...picks.get(k).map((value) => value.toFixed(2)),
      fitted.off ? fitted.off[row].toFixed(2) : ""];
    const line = document.createElement("tr");
    line.className = k === active ? "active" : "";
    line.append(...cells.map((text) => Object.assign(document.createElement("td"), { textContent: text })));
    const button = Object.assign(document.createElement("button"), { textContent: "remove", onclick: () => remove(k) });
    line.append(Object.assign(document.createElement("td"), {}));
    line.lastChild.append(button);
    line.onclick = (event) => { if (event.target !== button) choose(k); };
    return line;
  }));
  for (const id of ["save", "copy"]) element(id).disabled = chosen.length === 0;
}

// The model's edges in the photo, without those between two faces that are turned away.
function projectedEdges() {
  const { vertices, edges } = model.model;
  const q = [], points = [], [x, y, z, radius] = told.middle;
  for (let k = 0; k < vertices.length; k += 3) {
    points.push([x + radius * vertices[k], y + radius * vertices[k + 1], z + radius * vertices[k + 2]]);
    q.push(null);
  }
  const at = (k) => { if (q[k] === null) q[k] = fitted.project(points[k]) || false; return q[k]; };
  const faces = (n, k) => !([0, 1, 2].reduce((sum, c) => sum + normals[n + c] * (fitted.eye[c] - points[k][c]), 0) <= 0);
  const lines = [];
  for (let e = 0; e < edges.length; e += 2) {
    if (!faces(3 * e, edges[e]) && !faces(3 * e + 3, edges[e])) continue; // NaN, where there is no face, faces all
    const [a, b] = [at(edges[e]), at(edges[e + 1])];
    if (a && b) lines.push([...a, ...b]);
  }
  return lines;
}

function csv() {
  const quoted = (name) => (/[",\s]/.test(name) ? `"${name.replaceAll('"', '""')}"` : name);
  const rows = [...picks].map(([k, q]) => [quoted(told.names[k]), ...corners[k].map(shown), ...q.map((v) => v.toFixed(2))].join(","));
  return ["name,X_mm,Y_mm,Z_mm,x_px,y_px", ...rows, ""].join("\n");
}

// What has been picked outlives the page, where the browser lets it.
function keep() {
  try { localStorage.setItem(told.key, JSON.stringify([...picks])); } catch { /* private windows keep nothing */ }
}

function restore() {
  told.picked.forEach(([corner, x, y]) => picks.set(corner, [x, y]));
  try {
    const kept = JSON.parse(localStorage.getItem(told.key) || "[]");
    if (kept.length) picks.clear();
    kept.filter(([corner]) => corner < corners.length).forEach(([corner, q]) => picks.set(corner, q));
  } catch { /* nothing was kept */ }
}

element("save").onclick = () => {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([csv()], { type: "text/csv" }));
  link.download = "points.csv";
  link.click();
};
element("copy").onclick = async () => {
  try {
    await navigator.clipboard.writeText(csv());
    refresh("Copied: paste it into a file points.csv.");
  } catch {
    refresh("The browser does not let a page copy: save the file instead.");
  }
};
element("clear").onclick = () => { if (window.confirm("Remove all picks?")) { picks.clear(); active = -1; keep(); refresh(); } };
element("lines").onchange = () => refresh();
element("whole").onclick = () => { photo.fit(); photo.show(); };
window.addEventListener("keydown", (event) => {
  const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  if (!way || !picks.has(active)) return;
  event.preventDefault();
  const [x, y] = picks.get(active), step = event.shiftKey ? 1 : 0.1;
  put(active, x + step * way[0], y + step * way[1]);
});
window.addEventListener("resize", () => { photo.fit(); model.draw(); refresh(); });
window.addEventListener("load", () => {
  restore();
  photo.fit();
  model.draw();
  refresh();
});
