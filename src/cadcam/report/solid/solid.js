// A body as a picture that can be turned: drawn by a z-buffer of its own, since a page must not depend on WebGL.

const UPRIGHT = [1, 0, 0, 0, 0, -1, 0, 1, 0]; // seen along Y, with Z up
const MOST = 300000; // faces that are filled in a fraction of a second
const CLOSE = -1e9; // a cut nearer than everything

class Solid {
  // model: vertices (Float32Array, 3 each, about the body's middle, of radius 1), faces (Uint32Array, 3 each), edges
  // (Uint32Array, 2 each), colors ("#rrggbb" each), paint (color of each face; 255: not filled), styles ({color: "#rrggbb", width:
  // px, through: whether it shows, dotted, where it is hidden}), style (of each edge); all but the first three may lack.
  constructor(canvas, model, listened = {}) {
    this.canvas = canvas;
    this.model = model;
    this.paint = model.paint;
    this.turn = product(turned(0, -0.5), product(turned(0.6, 0), UPRIGHT));
    this.zoom = 1;
    this.shift = [0, 0];
    this.cut = CLOSE; // depth, in radii, before which nothing is drawn
    dragged(canvas, {
      move: (dx, dy, event) => this.dragged(dx, dy, event),
      wheel: (x, y, factor) => { this.zoomed(x, y, factor); },
      end: () => this.draw(),
      click: () => {},
      ...listened,
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

  // Positions on the drawing, in its px, and depths (larger is farther) of points.
  placed(points) {
    const out = new Float32Array(points.length), R = this.turn, [scale, cx, cy] = this.frame;
    for (let i = 0; i < points.length; i += 3) {
      const x = points[i], y = points[i + 1], z = points[i + 2];
      out[i] = cx + scale * (R[0] * x + R[1] * y + R[2] * z);
      out[i + 1] = cy + scale * (R[3] * x + R[4] * y + R[5] * z);
      out[i + 2] = scale * (R[6] * x + R[7] * y + R[8] * z);
    }
    return out;
  }

  // Draw all anew; coarse: pixels as large as that, while the body is being turned.
  draw(coarse = 1) {
    const rect = this.canvas.getBoundingClientRect();
    this.fine = Math.max(1, window.devicePixelRatio || 1) / coarse;
    const w = Math.max(1, Math.round(rect.width * this.fine)), h = Math.max(1, Math.round(rect.height * this.fine));
    const scale = 0.46 * this.zoom * Math.min(w, h);
    this.frame = [scale, w / 2 + this.fine * this.shift[0], h / 2 + this.fine * this.shift[1]];
    const image = new ImageData(w, h), color = new Uint32Array(image.data.buffer).fill(0xffffffff);
    const [face, line] = [new Int32Array(w * h).fill(-1), new Int32Array(w * h).fill(-1)];
    const sheet = { w, h, depth: new Float32Array(w * h).fill(Infinity), color, face, line };
    const v = this.placed(this.model.vertices), cut = this.cut * scale;
    const many = this.model.faces.length > 3 * MOST; // while such a body is being turned, its lines are shown alone
    if (coarse === 1 || !many) fill(sheet, v, this.model, this.paint, cut);
    stroke(sheet, v, this.model, cut, this.fine);
    this.sheet = sheet;
    this.picture = document.createElement("canvas");
    [this.picture.width, this.picture.height] = [w, h];
    this.picture.getContext("2d").putImageData(image, 0, 0);
    this.show();
  }

  // Show the last drawing, and return what to draw upon it with, its width and its height.
  show() {
    const drawn = sharp(this.canvas);
    drawn[0].drawImage(this.picture, 0, 0, drawn[1], drawn[2]);
    drawn[0].font = "600 13px system-ui, sans-serif";
    return drawn;
  }
}

// Fill triangles, flat and lit from the eye; they lie a little behind their place, so that edges show upon them.
function fill({ w, h, depth, color, face }, v, { faces, colors }, paint, cut) {
  const inks = paint && colors.map(parsed);
  for (let f = 0; f < faces.length; f += 3) {
    if (paint && paint[f / 3] === 255) continue;
    const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
    const ux = v[b] - v[a], uy = v[b + 1] - v[a + 1], uz = v[b + 2] - v[a + 2];
    const vx = v[c] - v[a], vy = v[c + 1] - v[a + 1], vz = v[c + 2] - v[a + 2];
    const area = ux * vy - uy * vx;
    if (area === 0) continue;
    const dzdx = (uz * vy - vz * uy) / area, dzdy = (ux * vz - vx * uz) / area;
    const light = 130 + 120 / Math.sqrt(1 + dzdx * dzdx + dzdy * dzdy);
    const inked = ink(paint ? inks[paint[f / 3]] : PAPER, light);
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
        const z = v[a + 2] + dzdx * px + dzdy * py, at = y * w + x;
        if (z >= cut && z + behind < depth[at]) { depth[at] = z + behind; color[at] = inked; face[at] = f / 3; }
      }
    }
  }
}

const THIN = { color: "#202830", width: 1, through: false };
const PAPER = [1, 1, 0.97];

// Draw those parts of edges that nothing hides, and those that show through, dotted.
function stroke({ w, h, depth, color, line }, v, { edges, styles, style }, cut, fine) {
  const order = [...Array(edges.length / 2).keys()];
  if (styles) order.sort((a, b) => style[a] - style[b]); // later styles upon earlier ones
  for (const e of order) {
    const { color: of, width, through } = styles ? styles[style[e]] : THIN;
    const a = 3 * edges[2 * e], b = 3 * edges[2 * e + 1], inked = ink(parsed(of), 255), half = Math.floor((width * fine) / 2);
    const steps = Math.ceil(Math.max(Math.abs(v[b] - v[a]), Math.abs(v[b + 1] - v[a + 1]), 1));
    if (steps > 20000) continue; // zoomed in to where nothing of it can be told
    for (let k = 0; k <= steps; k++) {
      const t = k / steps, z = v[a + 2] + t * (v[b + 2] - v[a + 2]);
      const x = Math.round(v[a] + t * (v[b] - v[a])), y = Math.round(v[a + 1] + t * (v[b + 1] - v[a + 1]));
      if (x < half || y < half || x >= w - half || y >= h - half || z < cut) continue;
      if (z > depth[y * w + x] && !(through && k % 8 < 4)) continue;
      line[y * w + x] = e;
      for (let dy = -half; dy <= half; dy++) color.fill(inked, (y + dy) * w + x - half, (y + dy) * w + x + half + 1);
    }
  }
}

// Red, green and blue, 0 to 1, of "#rrggbb".
function parsed(color) { return [1, 3, 5].map((k) => parseInt(color.slice(k, k + 2), 16) / 255); }

// A colour (0 to 1) under light (0 to 255), as a canvas keeps it.
function ink([r, g, b], light) {
  return (0xff000000 | (Math.round(b * light) << 16) | (Math.round(g * light) << 8) | Math.round(r * light)) >>> 0;
}

// Whether a point, placed on a drawing, is hidden at none of the nine pixels around it.
function seen(q, k, { w, h, depth }) {
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

// Numbers that the page holds as base64.
function numbers(text, type) {
  return new type(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
}
