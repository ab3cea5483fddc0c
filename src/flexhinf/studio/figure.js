// A figure of lines, bands and dots on a canvas: arrays arrive as 32-bit floats in base64, see drawing.py.
const floats = (text) => {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Float32Array(bytes.buffer);
};

const ROOM = { left: 58, right: 12, top: 8, bottom: 34 };
const FONT = "12px system-ui, sans-serif";

// Ticks at 1, 2 or 5 times a power of ten, about `count` of them.
const ticks = (low, high, count) => {
  const raw = (high - low) / Math.max(1, count);
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((k) => k * power).find((k) => k >= raw) || raw;
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k += 1) found.push(k * step);
  return found;
};

const decades = (low, high) => {
  const first = Math.ceil(low - 1e-9), last = Math.floor(high + 1e-9);
  const every = Math.max(1, Math.ceil((last - first + 1) / 7));
  const found = [];
  for (let k = first; k <= last; k += every) found.push(k);
  return found.length > 1 ? found : [low, high];
};

// A number with a power of ten where it is large or small.
const number = (value) => {
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size < 1e4 && size >= 1e-3) return String(Number(value.toPrecision(4))).replace("-", "−");
  const [mantissa, exponent] = value.toExponential(2).split("e");
  const raised = [...String(Number(exponent))].map((sign) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(sign)]).join("");
  return `${Number(mantissa)}·10${raised}`.replace("-", "−");
};

export default {
  template: `
    <figure class="studio-figure">
      <figcaption><span class="studio-figure-title">{{ title }}</span>
        <span v-for="entry in legend" class="studio-key" :key="entry.name">
          <span :class="['studio-swatch', entry.kind, { dash: entry.dash }]" :style="{ '--swatch': 'var(--studio-' + entry.colour + ')' }"></span>{{ entry.name }}</span>
      </figcaption>
      <canvas ref="canvas" role="img" :aria-label="description" :class="{ pickable }" @click="pick"></canvas>
    </figure>`,
  props: { title: String, xlabel: String, logx: Boolean, logy: Boolean, pickable: Boolean },
  data: () => ({ legend: [], description: "no curves yet" }),
  created() {
    this.series = {};
    this.stale = new Set();
    this.ylabel = "";
    this.stamps = [];
    this.waiting = false;
  },
  mounted() {
    this.observer = new ResizeObserver(() => this.later());
    this.observer.observe(this.$refs.canvas);
    this.scheme = new MutationObserver(() => this.later());
    this.scheme.observe(document.body, { attributes: true, attributeFilter: ["class"] });
  },
  unmounted() {
    this.observer.disconnect();
    this.scheme.disconnect();
  },
  methods: {
    // Curves by name replace those of the same name, null removes one; `stale` names those that wait for new numbers.
    show(data) {
      for (const [name, series] of Object.entries(data.series || {})) {
        this.stale.delete(name);
        if (series === null) delete this.series[name];
        else {
          const arrays = { x: floats(series.x), y: floats(series.y), top: series.top ? floats(series.top) : null };
          this.series[name] = { ...series, ...arrays };
        }
      }
      for (const name of data.stale || []) this.stale.add(name);
      if (data.order) this.order = data.order;
      if (data.ylabel !== undefined) this.ylabel = data.ylabel;
      if (data.description) this.description = data.description;
      const entries = this.ordered().filter((each) => each.name);
      this.legend = entries.map(({ name, colour, kind, dash, mark }) => ({ name, colour, kind: mark === "x" ? "cross" : kind, dash: !!dash }));
      if (data.stamp) this.stamps.push(data.stamp);
      this.later();
    },
    ordered() {
      const names = Object.keys(this.series);
      const order = this.order || names;
      return order.filter((name) => this.series[name]).map((name) => ({ key: name, ...this.series[name] }));
    },
    later() {
      if (this.waiting) return;
      this.waiting = true;
      requestAnimationFrame(() => {
        this.waiting = false;
        this.draw();
        const at = performance.now();
        for (const stamp of this.stamps.splice(0)) {
          (window.studioDrawn = window.studioDrawn || []).push({ ...stamp, at });
          if (window.studioDrawn.length > 500) window.studioDrawn.shift();
        }
      });
    },
    ranges(all) {
      const range = { x: [Infinity, -Infinity], y: [Infinity, -Infinity] };
      const widen = (axis, values, log) => {
        for (const raw of values || []) {
          const value = log ? Math.log10(raw) : raw;
          if (!Number.isFinite(value)) continue;
          if (value < range[axis][0]) range[axis][0] = value;
          if (value > range[axis][1]) range[axis][1] = value;
        }
      };
      for (const each of all) {
        widen("x", each.x, this.logx);
        widen("y", each.y, this.logy);
        widen("y", each.top, this.logy);
      }
      for (const axis of ["x", "y"]) {
        let [low, high] = range[axis];
        if (!(low <= high)) [low, high] = [0, 1];
        const margin = axis === "y" || all.some((each) => each.kind === "dots") ? 0.06 * (high - low) || 0.5 * Math.abs(high) || 1 : 0;
        range[axis] = [low - margin, high + margin || low + 1];
      }
      if (this.logy) range.y = [Math.max(range.y[0], -4), range.y[1]];
      return range;
    },
    draw() {
      const canvas = this.$refs.canvas;
      if (!canvas || !canvas.clientWidth) return;
      const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
      if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(height * ratio);
      }
      const pen = canvas.getContext("2d"), style = getComputedStyle(canvas);
      const colour = (name) => style.getPropertyValue(`--studio-${name}`).trim();
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      pen.clearRect(0, 0, width, height);
      const all = this.ordered(), range = this.ranges(all);
      if (!all.length) {
        // no axes, whose numbers would be made up
        [pen.font, pen.fillStyle, pen.textAlign, pen.textBaseline] = [FONT, colour("text"), "center", "middle"];
        pen.fillText(this.description, width / 2, height / 2);
        return;
      }
      const inner = { w: width - ROOM.left - ROOM.right, h: height - ROOM.top - ROOM.bottom };
      const px = (v) => ROOM.left + (inner.w * ((this.logx ? Math.log10(v) : v) - range.x[0])) / (range.x[1] - range.x[0]);
      const py = (v) => ROOM.top + inner.h - (inner.h * ((this.logy ? Math.log10(Math.max(v, 1e-12)) : v) - range.y[0])) / (range.y[1] - range.y[0]);
      this.back = {
        x: (at) => this.unlog(range.x[0] + ((at - ROOM.left) / inner.w) * (range.x[1] - range.x[0]), this.logx),
        y: (at) => this.unlog(range.y[0] + ((ROOM.top + inner.h - at) / inner.h) * (range.y[1] - range.y[0]), this.logy),
      };
      this.axes(pen, colour, range, inner, px, py);
      pen.save();
      pen.beginPath();
      pen.rect(ROOM.left, ROOM.top, inner.w, inner.h);
      pen.clip();
      for (const each of all) this.trace(pen, colour, each, px, py);
      pen.restore();
    },
    unlog: (value, log) => (log ? 10 ** value : value),
    axes(pen, colour, range, inner, px, py) {
      pen.font = FONT;
      pen.lineWidth = 1;
      pen.strokeStyle = colour("grid");
      pen.fillStyle = colour("text");
      const rows = this.logy ? decades(...range.y).map((k) => 10 ** k) : ticks(...range.y, inner.h / 40);
      const columns = this.logx ? decades(...range.x).map((k) => 10 ** k) : ticks(...range.x, inner.w / 80);
      pen.textAlign = "right";
      pen.textBaseline = "middle";
      for (const value of rows) {
        const y = Math.round(py(value)) + 0.5;
        pen.beginPath();
        pen.moveTo(ROOM.left, y);
        pen.lineTo(ROOM.left + inner.w, y);
        pen.stroke();
        pen.fillText(number(value), ROOM.left - 6, y);
      }
      pen.textAlign = "center";
      pen.textBaseline = "top";
      for (const value of columns) {
        const x = Math.round(px(value)) + 0.5;
        pen.beginPath();
        pen.moveTo(x, ROOM.top);
        pen.lineTo(x, ROOM.top + inner.h);
        pen.stroke();
        pen.fillText(number(value), Math.min(x, ROOM.left + inner.w + ROOM.right - 2 - pen.measureText(number(value)).width / 2), ROOM.top + inner.h + 4);
      }
      pen.fillText(this.xlabel, ROOM.left + inner.w / 2, ROOM.top + inner.h + 19);
      pen.save();
      pen.translate(2, ROOM.top + inner.h / 2);
      pen.rotate(-Math.PI / 2);
      pen.fillText(this.ylabel, 0, 0);
      pen.restore();
    },
    trace(pen, colour, each, px, py) {
      const stale = this.stale.has(each.key);
      pen.strokeStyle = pen.fillStyle = colour(each.colour);
      pen.setLineDash(each.dash ? [6, 4] : []);
      if (each.kind === "dots") {
        pen.lineWidth = 1.6;
        for (let k = 0; k < each.x.length; k += 1) this.mark(pen, each.mark, px(each.x[k]), py(each.y[k]));
      } else if (each.kind === "band") {
        pen.globalAlpha = stale ? 0.08 : 0.2;
        pen.beginPath();
        const last = each.x.length - 1;
        for (let k = 0; k <= last; k += 1) if (Number.isFinite(each.y[k])) pen.lineTo(px(each.x[k]), py(each.y[k]));
        for (let k = last; k >= 0; k -= 1) if (Number.isFinite(each.top[k])) pen.lineTo(px(each.x[k]), py(each.top[k]));
        pen.fill();
      } else {
        pen.globalAlpha = stale ? 0.35 : 1;
        pen.lineWidth = each.colour === "faint" || each.colour === "limit" ? 1.2 : 1.8;
        pen.beginPath();
        let open = false;
        for (let k = 0; k < each.x.length; k += 1) {
          const drawn = Number.isFinite(each.y[k]);
          if (drawn && open) pen.lineTo(px(each.x[k]), py(each.y[k]));
          else if (drawn) pen.moveTo(px(each.x[k]), py(each.y[k]));
          open = drawn;
        }
        pen.stroke();
      }
      pen.globalAlpha = 1;
      pen.setLineDash([]);
    },
    mark(pen, kind, x, y) {
      pen.beginPath();
      if (kind === "o") pen.arc(x, y, 4, 0, 2 * Math.PI);
      else {
        pen.moveTo(x - 4, y - 4);
        pen.lineTo(x + 4, y + 4);
        pen.moveTo(x - 4, y + 4);
        pen.lineTo(x + 4, y - 4);
      }
      pen.stroke();
    },
    pick(event) {
      if (!this.pickable || !this.back) return;
      this.$emit("pick", { x: this.back.x(event.offsetX), y: this.back.y(event.offsetY) });
    },
  },
};
