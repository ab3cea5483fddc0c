// The arms on their canvases: where points of the links are on the screen, and back.

const add = (a, b) => a.map((v, i) => v + b[i]);
const minus = (a, b) => a.map((v, i) => v - b[i]);
const times = (a, k) => a.map((v) => v * k);
const dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const length = (a) => Math.sqrt(dot(a, a));
const unit = (a) => times(a, 1 / (length(a) || 1));
const turned = (turn, v) => [0, 3, 6].map((row) => turn[row] * v[0] + turn[row + 1] * v[1] + turn[row + 2] * v[2]);
const turnedBack = (turn, v) => [0, 1, 2].map((k) => turn[k] * v[0] + turn[k + 3] * v[1] + turn[k + 6] * v[2]);

// Lines of the links in the world: from each joint to those that it carries, or to the link's end.
function skeleton(settings, frames) {
  return frames.map((frame, i) => {
    const children = frames.filter((_, k) => settings.parents[k] === i).map((child) => child.at);
    const end = settings.ends[i];
    return children.length || !end ? [frame.at, ...children] : [frame.at, add(frame.at, turned(frame.turn, end))];
  });
}

// An empty canvas with as many pixels as the screen has there: its context, and its width and height on the page.
function fitted(canvas) {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

const MARGIN = 0.12; // of the reach, about what is shown at first
const WAY = 8; // poses between start and goal that are shown

class View {
  constructor(simulation) {
    this.simulation = simulation;
    const s = (this.settings = simulation.s);
    this.tip = s.ends.reduce((last, end, i) => (end ? i : last), 0);
    this.planar = s.plane !== null; // the arm stays in a plane, which is seen as in the report
    [this.right, this.up] = s.plane || [null, times(unit(s.down), -1)];
    this.azimuth = -0.9;
    this.elevation = 0.35;
    this.orient();
    this.measure();
  }

  // How far the arm reaches at poses within its ranges, from the middle on the screen, m; and what is shown at first.
  measure() {
    const { settings: s, simulation: sim } = this, random = randomNumbers(1);
    this.origin = this.planar ? sim.frames(s.start)[0].at : [0, 0, 0];
    this.reach = 0;
    for (let k = 0; k < 200; k++) {
      const pose = k ? s.low.map((low, j) => low + random() * (s.high[j] - low)) : s.start;
      for (const p of skeleton(s, sim.frames(pose)).flat()) this.reach = Math.max(this.reach, length(minus(p, this.origin)));
    }
    this.begin();
  }

  // The way from start to goal is shown, with a margin; a pose beyond it later adds to what is shown.
  begin() {
    const { settings: s } = this, least = this.planar ? 0 : 0.18 * this.reach; // the ring on the ground
    this.shown = { left: least, right: least, above: 0, below: 0 };
    for (let k = 0; k <= WAY; k++) this.include(s.start.map((q, j) => q + (k / WAY) * (s.goal[j] - q)));
    for (const side of Object.keys(this.shown)) this.shown[side] += MARGIN * this.reach;
  }

  include(pose) {
    const { shown } = this;
    for (const p of skeleton(this.settings, this.simulation.frames(pose)).flat()) {
      const away = minus(p, this.origin), height = dot(away, this.up);
      const aside = this.planar ? dot(away, this.right) : length(minus(away, times(this.up, height)));
      if (!Number.isFinite(aside + height)) return;
      shown.right = Math.max(shown.right, aside);
      shown.left = Math.max(shown.left, this.planar ? -aside : aside); // a spatial view turns
      shown.above = Math.max(shown.above, height);
      shown.below = Math.max(shown.below, -height);
    }
  }

  orient() {
    if (this.planar) return;
    const flat = unit(Math.abs(this.up[0]) < 0.9 ? minus([1, 0, 0], times(this.up, this.up[0])) : minus([0, 1, 0], times(this.up, this.up[1])));
    const other = cross(this.up, flat), { azimuth: a, elevation: e } = this;
    const away = add(times(flat, Math.cos(a)), times(other, Math.sin(a)));
    this.right = cross(away, this.up);
    this.top = add(times(this.up, Math.cos(e)), times(away, Math.sin(e)));
  }

  // What is shown, from the middle to the left, the right, up and down on the screen, m.
  box() {
    const { left, right, above, below } = this.shown;
    if (this.planar) return [left, right, above, below];
    const flat = left * Math.sin(Math.abs(this.elevation)), tall = Math.cos(this.elevation);
    return [left, right, above * tall + flat, below * tall + flat];
  }

  // Width over height of a canvas that is filled; an arm that moves little up and down keeps room to be pulled.
  aspect() {
    const [left, right, above, below] = this.box();
    return Math.min(1.5, (left + right) / (above + below));
  }

  // Sizes of a canvas on the screen; called before anything is drawn on it.
  fit(canvas) {
    const { context, width, height } = fitted(canvas), [left, right, above, below] = this.box();
    Object.assign(this, { width, height });
    // The ring of the goal, 13 px from its middle to its edge, stays within narrow pictures too.
    this.scale = Math.min((width - 26) / (left + right), (height - 26) / (above + below));
    this.middle = [0.5 * (width + this.scale * (left - right)), 0.5 * (height + this.scale * (above - below))];
    return context;
  }

  point(p) {
    const top = this.planar ? this.up : this.top;
    const away = minus(p, this.origin);
    return [this.middle[0] + this.scale * dot(away, this.right), this.middle[1] - this.scale * dot(away, top)];
  }

  // The point of the world under a place on the screen, in the plane of the screen through another point.
  world(place, through) {
    const top = this.planar ? this.up : this.top, at = this.point(through);
    const x = (place[0] - at[0]) / this.scale, y = (at[1] - place[1]) / this.scale;
    return add(through, add(times(this.right, x), times(top, y)));
  }

  tipOf(frames) {
    const line = skeleton(this.settings, frames)[this.tip];
    return line[line.length - 1];
  }

  // The link nearest to a place on the screen: its number, the point in its frame, and the distance in pixels.
  nearest(place, pose) {
    const frames = this.simulation.frames(pose);
    let best = null;
    skeleton(this.settings, frames).forEach((line, link) => {
      for (let k = 1; k < line.length; k++) {
        const a = this.point(line[0]), b = this.point(line[k]), way = minus(b, a);
        const share = Math.min(1, Math.max(0, dot(minus(place, a), way) / (dot(way, way) || 1)));
        const distance = length(minus(place, add(a, times(way, share))));
        if (best === null || distance < best.distance - 1) {
          const world = add(line[0], times(minus(line[k], line[0]), share));
          best = { link, distance, world, local: turnedBack(frames[link].turn, minus(world, frames[link].at)) };
        }
      }
    });
    return best;
  }

  // Joint positions that bring the tip near a point: damped least squares from a pose, within the joints' ranges.
  inverse(target, pose) {
    const s = this.settings, q = [...pose], n = q.length;
    for (let turn = 0; turn < 40; turn++) {
      const frames = this.simulation.frames(q), tip = this.tipOf(frames), error = minus(target, tip);
      if (length(error) < 1e-4 * this.reach) break;
      const chain = new Set();
      for (let i = this.tip; i >= 0; i = s.parents[i]) chain.add(i);
      const columns = frames.map((f, i) => (!chain.has(i) ? [0, 0, 0] : s.slides[i] ? f.axis : cross(f.axis, minus(tip, f.at))));
      // (J Jᵀ + λ) y = e, three equations
      const damping = (0.05 * this.reach) ** 2, m = [0, 1, 2].map((r) => [0, 1, 2].map((c) => columns.reduce((sum, v) => sum + v[r] * v[c], 0) + (r === c ? damping : 0)));
      const y = solved(m, error);
      for (let i = 0; i < n; i++) {
        const step = Math.max(-0.3, Math.min(0.3, dot(columns[i], y)));
        q[i] = Math.max(s.low[i], Math.min(s.high[i], q[i] + step));
      }
    }
    return q;
  }
}

function solved(m, right) {
  const det = dot(m[0], cross(m[1], m[2]));
  const columns = [0, 1, 2].map((k) => m.map((row) => row[k]));
  return [
    dot(right, cross(columns[1], columns[2])) / det,
    dot(columns[0], cross(right, columns[2])) / det,
    dot(columns[0], cross(columns[1], right)) / det,
  ];
}

function colours() {
  const style = getComputedStyle(document.documentElement);
  return Object.fromEntries(["paper", "raised", "ink", "muted", "rule", "ours", "rival", "goal", "pull"].map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

function stroke(context, points, colour, width, dash = []) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.setLineDash(dash);
  context.lineCap = context.lineJoin = "round";
  context.beginPath();
  points.forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
  context.stroke();
  context.setLineDash([]);
}

function disc(context, [x, y], radius, fill, edge = null, width = 2) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  if (fill) {
    context.fillStyle = fill;
    context.fill();
  }
  if (edge) {
    context.strokeStyle = edge;
    context.lineWidth = width;
    context.stroke();
  }
}

class ArmDrawing {
  constructor(view, canvas, arm, colour) {
    Object.assign(this, { view, canvas, arm, colour });
  }

  // All lines of a link as points on the screen.
  lines(pose) {
    const { view } = this;
    return skeleton(view.settings, view.simulation.frames(pose)).flatMap((line) => line.slice(1).map((end) => [view.point(line[0]), view.point(end)]));
  }

  draw(state) {
    const { view, arm } = this, { simulation: sim, settings: s } = view;
    const context = view.fit(this.canvas), palette = state.colours, own = palette[this.colour];
    const thick = Math.max(4, Math.min(10, 0.028 * Math.min(view.width, view.height)));
    this.ground(context, palette);
    if (s.commanded) this.goal(context, state, palette);
    if (!sim.lost(arm)) {
      const pose = sim.links(arm);
      view.include(pose);
      context.globalAlpha = sim.pairs ? 0.5 : 1;
      for (const line of this.lines(pose)) stroke(context, line, own, thick);
      context.globalAlpha = 1;
      this.perturbed(context, palette);
      this.motors(context, pose, palette, thick, state.factor);
      this.payload(context, pose, palette, state.payload);
    }
    if (arm === 0 || state.heldArm === arm) this.pull(context, state, palette);
  }

  // Thin lines over the link: most of the time they lie close together.
  perturbed(context, palette) {
    const { view, arm } = this, { simulation: sim } = view;
    context.globalAlpha = 0.3;
    for (let k = 1; k <= sim.pairs; k++) {
      const ghost = 2 * k + arm;
      if (sim.lost(ghost)) continue;
      for (const line of this.lines(sim.links(ghost))) stroke(context, line, palette.ink, 1.25);
    }
    context.globalAlpha = 1;
  }

  ground(context, palette) {
    const { view } = this, first = view.simulation.frames(view.settings.start)[0].at;
    const base = view.point(first);
    if (!view.planar) {
      const floor = view.point([0, 0, 0]);
      const ring = [...Array(33).keys()].map((k) => {
        const a = (k * Math.PI) / 16, flat = unit(cross(view.up, Math.abs(view.up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]));
        const other = cross(view.up, flat), r = 0.18 * view.reach;
        return view.point(add(times(flat, r * Math.cos(a)), times(other, r * Math.sin(a))));
      });
      stroke(context, ring, palette.rule, 1.5);
      stroke(context, [floor, base], palette.muted, 6);
    }
    disc(context, base, 9, palette.rule);
  }

  goal(context, state, palette) {
    const { view } = this;
    for (const line of this.lines(state.goal)) stroke(context, line, palette.goal, 1.5, [5, 5]);
    const tip = view.point(view.tipOf(view.simulation.frames(state.goal)));
    disc(context, tip, 9, null, palette.goal, 2.5);
    disc(context, tip, 2.5, palette.goal);
  }

  // A hand for each motor, where the link would be if its spring were not wound up, and an arc between them.
  motors(context, pose, palette, thick, factor) {
    const { view, arm } = this, { simulation: sim, settings: s } = view;
    const own = skeleton(s, sim.frames(pose));
    own.forEach((line, j) => {
      const centre = view.point(line[0]);
      if (s.elastic[j] && !s.slides[j]) {
        const other = skeleton(s, sim.motorFrames(arm, j, factor))[j];
        const from = view.point(line[1]), to = view.point(other[1]);
        const hand = add(centre, times(minus(to, centre), 0.72)), mark = add(centre, times(minus(from, centre), 0.72));
        stroke(context, [centre, hand], palette.ink, 2.5);
        disc(context, hand, 3.5, palette.ink);
        stroke(context, [mark, hand], palette.pull, 2);
      } else if (s.elastic[j]) {
        const other = skeleton(s, sim.motorFrames(arm, j, factor))[j];
        stroke(context, [view.point(line[0]), view.point(other[0])], palette.pull, 3);
        disc(context, view.point(other[0]), 4, palette.ink);
      }
      disc(context, centre, 0.62 * thick + 2, palette.raised, palette.ink, 2);
    });
  }

  payload(context, pose, palette, mass) {
    if (!(mass > 0)) return;
    const { view } = this, tip = view.point(view.tipOf(view.simulation.frames(pose)));
    disc(context, tip, Math.min(view.width, view.height) * (0.015 + 0.025 * Math.cbrt(mass)), palette.ink);
  }

  pull(context, state, palette) {
    const { view } = this, held = state.held;
    if (!held) return;
    const frames = view.simulation.frames(view.simulation.links(this.arm)), frame = frames[held.link];
    const point = view.point(add(frame.at, turned(frame.turn, held.local))), hand = view.point(held.hand);
    const way = minus(hand, point), far = length(way) || 1, aside = [-way[1] / far, way[0] / far], zigzag = [point];
    for (let k = 1; k < 16; k++) zigzag.push(add(add(point, times(way, k / 16)), times(aside, (k % 2 ? 1 : -1) * Math.min(6, 0.1 * far))));
    stroke(context, [...zigzag, hand], palette.pull, 1.75);
    disc(context, hand, 5, palette.pull);
    const newton = length(Array.from(view.simulation.force));
    context.fillStyle = palette.pull;
    context.font = "600 13px system-ui, sans-serif";
    context.textAlign = "left";
    const x = Math.min(view.width - 60, Math.max(6, hand[0] + 10)), y = Math.min(view.height - 8, Math.max(16, hand[1] - 8));
    context.fillText(`${Number(newton.toPrecision(2))} N`, x, y);
  }
}
