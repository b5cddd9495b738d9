// The CAD model as a picture that can be turned: drawn by a z-buffer of its own, since a page must not depend on WebGL.

const UPRIGHT = [1, 0, 0, 0, 0, -1, 0, 1, 0]; // seen along Y, with Z up
const MOST = 300000; // faces that are filled in a fraction of a second

class ModelPane {
  // model: vertices (Float32Array, 3 each, about the model's middle, of radius 1), faces (Uint32Array, 3 each), edges
  // (Uint32Array, 2 each), corners (Float32Array as vertices). onPick(corner): a corner was clicked.
  constructor(canvas, model, onPick) {
    this.canvas = canvas;
    this.model = model;
    this.onPick = onPick;
    this.marks = new Map(); // corner -> label
    this.active = -1;
    this.turn = product(turned(0, -0.5), product(turned(0.6, 0), UPRIGHT));
    this.zoom = 1;
    this.shift = [0, 0];
    this.under = -1;
    dragged(canvas, {
      move: (dx, dy, event) => this.dragged(dx, dy, event),
      click: (x, y) => { const k = this.cornerAt(x, y); if (k >= 0) this.onPick(k); },
      hover: (x, y) => { const k = this.cornerAt(x, y); if (k !== this.under) { this.under = k; this.show(); } },
      wheel: (x, y, factor) => { this.zoomed(x, y, factor); },
      end: () => this.draw(),
    });
  }

  dragged(dx, dy, event) {
    if (event.shiftKey || event.buttons > 1) {
      this.shift = [this.shift[0] + dx, this.shift[1] + dy];
    } else {
      this.turn = product(turned(0.008 * dx, 0), product(turned(0, 0.008 * dy), this.turn));
    }
    this.draw(2);
  }

  zoomed(x, y, factor) {
    const rect = this.canvas.getBoundingClientRect();
    const at = [x - rect.width / 2, y - rect.height / 2];
    this.zoom *= factor;
    this.shift = this.shift.map((s, k) => at[k] - factor * (at[k] - s));
    this.draw();
  }

  // Positions on the canvas, in CSS px, and depths (larger is farther) of points.
  placed(points, scale, cx, cy) {
    const out = new Float32Array(points.length), R = this.turn;
    for (let i = 0; i < points.length; i += 3) {
      const x = points[i], y = points[i + 1], z = points[i + 2];
      out[i] = cx + scale * (R[0] * x + R[1] * y + R[2] * z);
      out[i + 1] = cy + scale * (R[3] * x + R[4] * y + R[5] * z);
      out[i + 2] = scale * (R[6] * x + R[7] * y + R[8] * z);
    }
    return out;
  }

  // Draw all anew; coarse: pixels as large as that, while the model is being turned.
  draw(coarse = 1) {
    const rect = this.canvas.getBoundingClientRect();
    const fine = Math.max(1, window.devicePixelRatio || 1) / coarse;
    const w = Math.max(1, Math.round(rect.width * fine)), h = Math.max(1, Math.round(rect.height * fine));
    const scale = 0.46 * this.zoom * Math.min(w, h);
    const frame = [scale, w / 2 + fine * this.shift[0], h / 2 + fine * this.shift[1]];
    const v = this.placed(this.model.vertices, ...frame);
    const image = new ImageData(w, h), color = new Uint32Array(image.data.buffer).fill(0xffffffff);
    const depth = new Float32Array(w * h).fill(Infinity);
    const many = this.model.faces.length > 3 * MOST; // while such a model is being turned, its lines are shown alone
    if (coarse === 1 || !many) shade(v, this.model.faces, w, h, depth, color);
    stroke(v, this.model.edges, w, h, depth, color);
    const q = this.placed(this.model.corners, ...frame);
    this.places = q.map((value) => value / fine);
    this.visible = new Uint8Array(q.length / 3);
    for (let k = 0; k < this.visible.length; k++) this.visible[k] = seen(q, 3 * k, w, h, depth);
    this.picture = document.createElement("canvas");
    this.picture.width = w;
    this.picture.height = h;
    this.picture.getContext("2d").putImageData(image, 0, 0);
    this.show();
  }

  // Show the last drawing with the corners upon it.
  show() {
    const [context, width, height] = sharp(this.canvas);
    context.drawImage(this.picture, 0, 0, width, height);
    context.font = "600 13px system-ui, sans-serif";
    for (let k = 0; k < this.visible.length; k++) {
      const label = this.marks.get(k);
      if (!this.visible[k] && label === undefined && k !== this.active) continue;
      const x = this.places[3 * k], y = this.places[3 * k + 1];
      const special = k === this.active || k === this.under;
      context.beginPath();
      context.arc(x, y, special ? 6 : 3.5, 0, 2 * Math.PI);
      context.globalAlpha = this.visible[k] ? 1 : 0.4;
      context.fillStyle = k === this.active ? "#d55e00" : label === undefined ? "#0072b2" : "#009e73";
      context.fill();
      if (special) { context.lineWidth = 2; context.strokeStyle = "#ffffff"; context.stroke(); }
      if (label !== undefined) written(context, label, x + 8, y - 6, "#00513b");
      context.globalAlpha = 1;
    }
    if (this.under >= 0) written(context, this.model.said(this.under), 10, height - 12, "#1c1c1c");
  }

  // The visible corner within a dozen px of a place, or -1.
  cornerAt(x, y) {
    let best = -1, least = 12 * 12;
    for (let k = 0; k < this.visible.length; k++) {
      const far = (this.places[3 * k] - x) ** 2 + (this.places[3 * k + 1] - y) ** 2;
      if (this.visible[k] && far < least) [best, least] = [k, far];
    }
    return best;
  }
}

// Fill triangles, flat and lit from the eye; they lie a little behind their place, so that edges show upon them.
function shade(v, faces, w, h, depth, color) {
  for (let f = 0; f < faces.length; f += 3) {
    const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
    const ux = v[b] - v[a], uy = v[b + 1] - v[a + 1], uz = v[b + 2] - v[a + 2];
    const vx = v[c] - v[a], vy = v[c + 1] - v[a + 1], vz = v[c + 2] - v[a + 2];
    const area = ux * vy - uy * vx;
    if (area === 0) continue;
    const dzdx = (uz * vy - vz * uy) / area, dzdy = (ux * vz - vx * uz) / area;
    const facing = 1 / Math.sqrt(1 + dzdx * dzdx + dzdy * dzdy);
    const gray = Math.round(120 + 110 * facing);
    const paint = 0xff000000 | (gray << 16) | (gray << 8) | Math.round(0.97 * gray);
    const sx = vy / area, sy = -vx / area, tx = -uy / area, ty = ux / area;
    const behind = 0.6 + Math.min(3, Math.abs(dzdx) + Math.abs(dzdy));
    const x0 = Math.max(0, Math.ceil(Math.min(v[a], v[b], v[c]))), x1 = Math.min(w - 1, Math.max(v[a], v[b], v[c]));
    const y0 = Math.max(0, Math.ceil(Math.min(v[a + 1], v[b + 1], v[c + 1])));
    const y1 = Math.min(h - 1, Math.max(v[a + 1], v[b + 1], v[c + 1]));
    for (let y = y0; y <= y1; y++) {
      for (let x = x0; x <= x1; x++) {
        const px = x - v[a], py = y - v[a + 1];
        const s = px * sx + py * sy, t = px * tx + py * ty;
        if (s < 0 || t < 0 || s + t > 1) continue;
        const z = v[a + 2] + dzdx * px + dzdy * py + behind, at = y * w + x;
        if (z < depth[at]) { depth[at] = z; color[at] = paint; }
      }
    }
  }
}

// Draw those parts of edges that nothing hides.
function stroke(v, edges, w, h, depth, color) {
  for (let e = 0; e < edges.length; e += 2) {
    const a = 3 * edges[e], b = 3 * edges[e + 1];
    const steps = Math.ceil(Math.max(Math.abs(v[b] - v[a]), Math.abs(v[b + 1] - v[a + 1]), 1));
    if (steps > 20000) continue; // zoomed in to where nothing of it can be told
    for (let k = 0; k <= steps; k++) {
      const t = k / steps;
      const x = Math.round(v[a] + t * (v[b] - v[a])), y = Math.round(v[a + 1] + t * (v[b + 1] - v[a + 1]));
      if (x < 0 || y < 0 || x >= w || y >= h) continue;
      if (v[a + 2] + t * (v[b + 2] - v[a + 2]) <= depth[y * w + x]) color[y * w + x] = 0xff302820;
    }
  }
}

// Whether a point is hidden at none of the nine pixels around it.
function seen(q, k, w, h, depth) {
  const x = Math.round(q[k]), y = Math.round(q[k + 1]);
  if (x < 1 || y < 1 || x >= w - 1 || y >= h - 1) return 0;
  for (let dy = -1; dy <= 1; dy++) {
    for (let dx = -1; dx <= 1; dx++) if (q[k + 2] <= depth[(y + dy) * w + x + dx] + 1) return 1;
  }
  return 0;
}

// A rotation (9) about the vertical by one angle, then about the horizontal by another; y points down, z away.
function turned(about, over) {
  const [c, s, d, t] = [Math.cos(about), Math.sin(about), Math.cos(over), Math.sin(over)];
  return product([1, 0, 0, 0, d, t, 0, -t, d], [c, 0, s, 0, 1, 0, -s, 0, c]);
}

function product(A, B) {
  return [0, 3, 6].flatMap((r) => [0, 1, 2].map((c) => A[r] * B[c] + A[r + 1] * B[3 + c] + A[r + 2] * B[6 + c]));
}
