// Numbers as text, and plots that scroll: the last seconds of some signals, in a ring of samples.

// So many digits, and at most three behind the point.
function digits(value, count = 3) {
  if (!Number.isFinite(value)) return "–";
  const whole = Math.floor(Math.log10(Math.abs(value) || 1)) + 1;
  const text = value.toFixed(Math.min(3, Math.max(0, count - whole)));
  return (Number(text) === 0 ? "0" : String(Number(text))).replace("-", "−");
}

// So many digits of a number of any size.
function significant(value, count = 3) {
  const size = Math.abs(value);
  if (size === 0 || (size >= 1e-3 && size < 1e6)) return String(Number(value.toPrecision(count))).replace("-", "−");
  const [mantissa, exponent] = value.toExponential(count - 1).split("e");
  return `${Number(mantissa)}·10^${Number(exponent)}`.replaceAll("-", "−");
}

// A number with its unit; degrees stand at their number.
function withUnit(value, unit, count = 3) {
  return `${digits(value, count)}${unit === "°" ? "" : " "}${unit}`;
}

class History {
  constructor(names, capacity) {
    this.capacity = capacity;
    this.columns = Object.fromEntries(["time", ...names].map((name) => [name, new Float64Array(capacity).fill(NaN)]));
    this.clear();
  }

  clear() {
    this.next = 0;
    this.count = 0;
  }

  add(row) {
    for (const name in this.columns) this.columns[name][this.next] = row[name];
    this.next = (this.next + 1) % this.capacity;
    this.count = Math.min(this.count + 1, this.capacity);
  }

  // Calls back with time and value of each sample since a time, the oldest first.
  each(name, since, visit) {
    const time = this.columns.time, values = this.columns[name];
    for (let k = 0; k < this.count; k++) {
      const i = (this.next - this.count + k + this.capacity) % this.capacity;
      if (time[i] >= since) visit(time[i], values[i]);
    }
  }
}

// A round step of an axis with about so many parts.
function roundStep(span, parts) {
  const rough = span / parts, power = 10 ** Math.floor(Math.log10(rough));
  return power * [1, 2, 5, 10].find((k) => k * power >= 0.999 * rough);
}

class Plot {
  // lines: {name, colour, dash, width}; limits: values that are dashed where they are near.
  constructor(canvas, lines, seconds, least) {
    Object.assign(this, { canvas, lines, seconds, least });
    this.limits = [];
  }

  draw(history, now, palette) {
    const { context, width, height } = fitted(this.canvas);
    const since = Math.max(0, now - this.seconds), left = 46, right = width - 6, top = 6, bottom = height - 18;
    const [low, high] = this.range(history, since);
    const x = (t) => left + ((t - since) / this.seconds) * (right - left);
    const y = (v) => bottom - ((v - low) / (high - low)) * (bottom - top);
    this.axes(context, palette, { low, high, since, left, right, top, bottom, x, y });
    context.save();
    context.beginPath();
    context.rect(left, top - 2, right - left, bottom - top + 4);
    context.clip();
    for (const limit of this.limits) {
      if (limit > low && limit < high) stroke(context, [[left, y(limit)], [right, y(limit)]], palette.pull, 1.25, [6, 4]);
    }
    for (const line of this.lines) {
      if (line.shown && !line.shown()) continue;
      const points = [];
      history.each(line.name, since, (t, v) => Number.isFinite(v) && points.push([x(t), y(v)]));
      if (points.length > 1) stroke(context, points, palette[line.colour], line.width, line.dash || []);
    }
    context.restore();
  }

  range(history, since) {
    let low = Infinity, high = -Infinity;
    for (const line of this.lines) {
      if (line.shown && !line.shown()) continue;
      history.each(line.name, since, (_, v) => {
        if (!Number.isFinite(v)) return;
        low = Math.min(low, v);
        high = Math.max(high, v);
      });
    }
    if (!(high >= low)) [low, high] = [0, 0];
    for (const limit of this.limits) {
      if (Math.abs(limit) < 1.6 * Math.max(Math.abs(low), Math.abs(high))) {
        low = Math.min(low, limit);
        high = Math.max(high, limit);
      }
    }
    const middle = (low + high) / 2, half = Math.max((high - low) / 2, this.least / 2) * 1.1;
    return [middle - half, middle + half];
  }

  axes(context, palette, a) {
    context.font = "11px system-ui, sans-serif";
    context.fillStyle = palette.muted;
    context.textBaseline = "middle";
    context.textAlign = "right";
    const step = roundStep(a.high - a.low, 4), digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    for (let v = Math.ceil(a.low / step) * step; v <= a.high; v += step) {
      stroke(context, [[a.left, a.y(v)], [a.right, a.y(v)]], palette.rule, 1);
      const text = (Math.abs(v) < step / 1e6 ? 0 : v).toFixed(Math.min(digits, 6));
      if (a.y(v) > 4) context.fillText(text.replace("-", "−"), a.left - 5, a.y(v));
    }
    context.textAlign = "center";
    for (let t = Math.ceil(a.since); t <= a.since + this.seconds; t += 2) {
      if (a.x(t) < a.right - 12) context.fillText(`${t} s`, a.x(t), a.bottom + 10);
    }
  }
}
