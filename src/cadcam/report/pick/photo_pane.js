// The photo, to zoom into and to click in to tenths of a pixel. (0, 0) is the centre of the top left pixel.

class PhotoPane {
  // onPlace(x, y): a place was clicked, in px of the photo; onMove(corner, x, y): its mark was dragged there.
  constructor(canvas, image, onPlace, onMove) {
    this.canvas = canvas;
    this.image = image;
    this.marks = []; // {corner, name, x, y, active, ghost}
    this.lines = []; // polylines of the model as fitted: [x, y, x, y]
    this.cursor = null;
    this.fit();
    let held = null;
    dragged(canvas, {
      start: (x, y) => { held = this.markAt(x, y); },
      move: (dx, dy) => {
        if (held === null) { this.shift = [this.shift[0] + dx, this.shift[1] + dy]; this.show(); return; }
        onMove(held.corner, held.x + dx / this.scale, held.y + dy / this.scale);
        held = this.marks.find((mark) => mark.corner === held.corner) || null;
      },
      click: (x, y) => onPlace(...this.pixel(x, y)),
      hover: (x, y) => { this.cursor = [x, y]; this.show(); },
      leave: () => { this.cursor = null; this.show(); },
      wheel: (x, y, factor) => this.zoomed(x, y, factor),
    });
  }

  // Show all of the photo.
  fit() {
    const rect = this.canvas.getBoundingClientRect(), { naturalWidth: w, naturalHeight: h } = this.image;
    this.scale = Math.min(rect.width / w, rect.height / h);
    this.shift = [(rect.width - this.scale * w) / 2, (rect.height - this.scale * h) / 2];
  }

  zoomed(x, y, factor) {
    const scale = Math.min(64, Math.max(0.02, this.scale * factor));
    this.shift = this.shift.map((s, k) => [x, y][k] - (scale / this.scale) * ([x, y][k] - s));
    this.scale = scale;
    this.show();
  }

  // Bring a place into view.
  lookAt(x, y) {
    const rect = this.canvas.getBoundingClientRect(), [u, v] = this.place(x, y);
    if (u > 20 && v > 20 && u < rect.width - 20 && v < rect.height - 20) return;
    this.shift = [this.shift[0] + rect.width / 2 - u, this.shift[1] + rect.height / 2 - v];
  }

  pixel(x, y) { return [(x - this.shift[0]) / this.scale - 0.5, (y - this.shift[1]) / this.scale - 0.5]; }

  place(x, y) { return [(x + 0.5) * this.scale + this.shift[0], (y + 0.5) * this.scale + this.shift[1]]; }

  markAt(x, y) {
    const near = (mark) => { const [u, v] = this.place(mark.x, mark.y); return Math.hypot(u - x, v - y) < 9; };
    return this.marks.find((mark) => !mark.ghost && near(mark)) || null;
  }

  show() {
    const [context, width, height] = sharp(this.canvas);
    this.paint(context, this.scale, this.shift);
    if (this.cursor !== null) this.magnify(context, width, height);
  }

  paint(context, scale, shift) {
    const { naturalWidth: w, naturalHeight: h } = this.image;
    context.imageSmoothingEnabled = scale < 2;
    context.drawImage(this.image, shift[0], shift[1], w * scale, h * scale);
    const to = (x, y) => [(x + 0.5) * scale + shift[0], (y + 0.5) * scale + shift[1]];
    context.strokeStyle = "rgba(0, 200, 120, 0.9)";
    context.lineWidth = 1;
    context.beginPath();
    for (const line of this.lines) { context.moveTo(...to(line[0], line[1])); context.lineTo(...to(line[2], line[3])); }
    context.stroke();
    context.font = "600 13px system-ui, sans-serif";
    for (const mark of this.marks) {
      const [x, y] = to(mark.x, mark.y), color = mark.active ? "#d55e00" : "#009e73";
      context.beginPath();
      if (mark.ghost) {
        context.arc(x, y, 11, 0, 2 * Math.PI);
      } else {
        for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
          context.moveTo(x + 3 * dx, y + 3 * dy);
          context.lineTo(x + 11 * dx, y + 11 * dy);
        }
      }
      for (const [ink, line] of [["#ffffff", 4], [color, 2]]) {
        context.strokeStyle = ink;
        context.lineWidth = line;
        context.stroke();
      }
      if (!mark.ghost) written(context, mark.name, x + 10, y - 10, color);
    }
  }

  // What is under the cursor, eight times as large as in the photo, or as the pane.
  magnify(context, width, height) {
    const side = Math.min(170, width / 3), scale = Math.max(8, 2 * this.scale), [x, y] = this.pixel(...this.cursor);
    const left = this.cursor[0] > width / 2 ? 8 : width - side - 8, top = 8;
    context.save();
    context.beginPath();
    context.rect(left, top, side, side);
    context.fillStyle = "#000000";
    context.fill();
    context.clip();
    this.paint(context, scale, [left + side / 2 - (x + 0.5) * scale, top + side / 2 - (y + 0.5) * scale]);
    context.restore();
    context.strokeStyle = "#ffffff";
    context.lineWidth = 1;
    context.strokeRect(left, top, side, side);
    context.beginPath();
    context.moveTo(left + side / 2, top + side / 2 - 8);
    context.lineTo(left + side / 2, top + side / 2 + 8);
    context.moveTo(left + side / 2 - 8, top + side / 2);
    context.lineTo(left + side / 2 + 8, top + side / 2);
    context.globalCompositeOperation = "difference";
    context.stroke();
    context.globalCompositeOperation = "source-over";
    written(context, `x ${x.toFixed(1)}  y ${y.toFixed(1)}`, 10, height - 12, "#1c1c1c");
  }
}
