// Bodies in a report: each turned by dragging, cut open by a slider, seen from where a camera stood.

class SolidFigure extends Solid {
  // told: as `report.solid.figure` writes it.
  constructor(figure, told, listened = {}) {
    super(figure.querySelector("canvas"), {
      ...told,
      vertices: numbers(told.vertices, Float32Array),
      faces: numbers(told.faces, Uint32Array),
      part: numbers(told.part, Uint32Array),
      edges: numbers(told.edges, Uint32Array),
      style: numbers(told.style, Uint8Array),
    }, {
      hover: (x, y) => { this.pointer = [x, y]; this.show(); },
      leave: () => { [this.pointer, this.used] = [null, false]; this.show(); },
      start: () => { this.used = true; },
      wheels: (event) => event.ctrlKey || this.used, // else the page is being scrolled
      ...listened,
    });
    [this.pointer, this.used] = [null, false];
    this.slider = figure.querySelector("input");
    this.slider.oninput = () => { this.cut = Number(this.slider.value) <= -1 ? CLOSE : Number(this.slider.value); this.draw(); };
    const choice = figure.querySelector("select");
    this.chosen(told.paints[0]);
    if (choice) choice.onchange = () => { this.chosen(told.paints[choice.selectedIndex]); this.draw(); };
    figure.querySelectorAll("button").forEach((button, k) => { button.onclick = () => this.look(told.looks[k]); });
    window.addEventListener("resize", () => this.draw());
    this.look(told.looks[0]);
  }

  chosen({ color, words }) { [this.paint, this.words] = [numbers(color, Uint8Array), words]; }

  // Look as told: turned so, so much of it in the picture's height (null: all), its middle so far off the picture's (radii).
  look({ turn, tall, off, cut }) {
    const { width, height } = this.canvas.getBoundingClientRect();
    this.turn = turn;
    const [scale, middle] = tall === null ? this.filling(width, height) : [height / tall, off];
    this.zoom = scale / (0.46 * Math.min(width, height));
    this.shift = middle.map((value) => value * scale);
    [this.cut, this.slider.value] = [cut > -1 ? cut : CLOSE, Math.max(cut, -1)];
    this.draw();
  }

  // The px per radius with which all of it fills the picture, and its middle off the picture's.
  filling(width, height) {
    this.frame = [1, 0, 0];
    const q = this.placed(this.model.vertices), low = [Infinity, Infinity], high = [-Infinity, -Infinity];
    for (let k = 0; k < q.length; k++) {
      if (k % 3 < 2) [low[k % 3], high[k % 3]] = [Math.min(low[k % 3], q[k]), Math.max(high[k % 3], q[k])];
    }
    const scale = 0.92 * Math.min(width / (high[0] - low[0]), height / (high[1] - low[1]));
    return [scale, low.map((value, k) => -(value + high[k]) / 2)];
  }

  show() {
    const [context, width, height] = super.show();
    for (const { at, to, text, color } of this.model.marks) {
      const q = this.placed([...at, ...(to || at)]), [x, y, , u, v] = q.map((value) => value / this.fine);
      context.globalAlpha = seen(q, 0, this.sheet) || to ? 1 : 0.6;
      if (to) arrow(context, x, y, u, v, color);
      written(context, text, Math.max(4, Math.min(x + 8, width - context.measureText(text).width - 4)), y - 6, color);
    }
    context.globalAlpha = 1;
    const said = this.said();
    if (said) written(context, said, 10, height - 12, "#1c1c1c");
  }

  // What is told of the place under the pointer.
  said() {
    const face = this.under("face", 0);
    if (face < 0) return "";
    return [this.model.said[this.model.part[face]], this.words[this.paint[face]]].filter(Boolean).join(": ");
  }

  // The face, or line, nearest to the pointer, `within` px of the drawing; else -1.
  under(what, within) {
    if (this.pointer === null) return -1;
    const [x, y] = this.pointer.map((value) => Math.round(value * this.fine)), { w, h } = this.sheet;
    let best = -1, least = Infinity;
    for (let v = Math.max(0, y - within); v <= Math.min(h - 1, y + within); v++) {
      for (let u = Math.max(0, x - within); u <= Math.min(w - 1, x + within); u++) {
        const far = (u - x) ** 2 + (v - y) ** 2, found = this.sheet[what][v * w + u];
        if (found >= 0 && far < least) [best, least] = [found, far];
      }
    }
    return best;
  }
}

function arrow(context, x, y, u, v, color) {
  const long = Math.hypot(u - x, v - y);
  if (long < 2) return; // it points at whom looks
  const [c, s] = [(u - x) / long, (v - y) / long], barb = Math.min(9, long / 2);
  context.beginPath();
  context.moveTo(x, y);
  context.lineTo(u, v);
  for (const side of [-0.5, 0.5]) {
    context.moveTo(u, v);
    context.lineTo(u - barb * (c - side * s), v - barb * (s + side * c));
  }
  for (const [line, paint] of [[5, "#ffffff"], [2.5, color]]) {
    [context.lineWidth, context.strokeStyle] = [line, paint];
    context.stroke();
  }
}

const KINDS = { solid: SolidFigure }; // by the figure's data-kind
let solids = [];
window.addEventListener("load", () => {
  const told = (figure) => JSON.parse(figure.querySelector("script").textContent);
  solids = [...document.querySelectorAll("figure.solid")].map((f) => new KINDS[f.dataset.kind](f, told(f)));
});
