// The CAD model, of which corners can be clicked.

class ModelPane extends Solid {
  // model: as of `Solid`, and corners (Float32Array as vertices), said(corner). onPick(corner): a corner was clicked.
  constructor(canvas, model, onPick) {
    super(canvas, model, {
      click: (x, y) => { const k = this.cornerAt(x, y); if (k >= 0) onPick(k); },
      hover: (x, y) => { const k = this.cornerAt(x, y); if (k !== this.under) { this.under = k; this.show(); } },
    });
    this.marks = new Map(); // corner -> label
    this.active = -1;
    this.under = -1;
  }

  // Show the last drawing with the corners upon it.
  show() {
    const [context, , height] = super.show();
    const q = this.placed(this.model.corners);
    this.places = q.map((value) => value / this.fine);
    this.visible = new Uint8Array(q.length / 3);
    for (let k = 0; k < this.visible.length; k++) {
      this.visible[k] = seen(q, 3 * k, this.sheet);
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
