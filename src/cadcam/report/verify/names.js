// The names of a part: what the pointer is on, and a click's share of a tolerance file.

class NamesFigure extends SolidFigure {
  // told: as of `SolidFigure`, and names of its parts; of each line its chain and its part; words of each chain.
  constructor(figure, told) {
    super(figure, told, { click: (x, y) => { this.pointer = [x, y]; this.toggle(); } });
    [this.names, this.words_of] = [told.names, told.words];
    [this.chain, this.of] = [numbers(told.chain, Uint32Array), numbers(told.of, Uint32Array)];
    [this.plain, this.bodies, this.chains] = [this.paint.slice(), new Set(), new Map()];
    this.text = document.getElementById("entries");
    document.getElementById("copy").onclick = () => this.copy();
    document.getElementById("none").onclick = () => { this.bodies.clear(); this.chains.clear(); this.told(); };
    this.told();
  }

  said() {
    const line = this.under("line", Math.round(5 * this.fine));
    if (line < 0) return super.said();
    return `${this.names[this.of[line]]}: chain ${this.chain[line]}, ${this.words_of[this.chain[line]]}`;
  }

  // Choose what is under the pointer, or no longer: a chain of edges, else a whole body.
  toggle() {
    const line = this.under("line", Math.round(5 * this.fine)), face = this.under("face", 0);
    if (line >= 0) {
      if (!this.chains.delete(this.chain[line])) this.chains.set(this.chain[line], this.of[line]);
    } else if (face >= 0) {
      const part = this.model.part[face];
      if (!this.bodies.delete(part)) this.bodies.add(part);
    }
    this.told();
  }

  told() {
    this.model.style = this.chain.map((chain) => (this.chains.has(chain) ? 1 : 0));
    this.paint = this.plain.map((color, face) => (color !== 255 && this.bodies.has(this.model.part[face]) ? 0 : color));
    this.text.textContent = this.entries() || "Click edges, or bodies.";
    this.draw();
  }

  // The features that are chosen, as a tolerance file has them.
  entries() {
    const of = new Map([...this.bodies].map((part) => [part, null]));
    for (const [chain, part] of this.chains) if (!this.bodies.has(part)) of.set(part, [...(of.get(part) || []), chain]);
    const lines = [...of].flatMap(([part, chains]) => {
      const name = JSON.stringify(this.names[part]);
      const narrowed = chains ? [`    chains: [${chains.sort((a, b) => a - b).join(", ")}]`] : [];
      return [`  ${name}:`, `    part: ${name}`, ...narrowed, "    position_mm: 1"];
    });
    return lines.length ? ["features:", ...lines, ""].join("\n") : "";
  }

  async copy() {
    try {
      await navigator.clipboard.writeText(this.entries());
    } catch {
      window.getSelection().selectAllChildren(this.text); // the browser does not let a page copy
    }
  }
}

KINDS.names = NamesFigure;
