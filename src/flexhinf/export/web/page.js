// Controls and clock of the page.

const SHOWN = 8; // seconds in the plots
const CHUNK = 4e-3; // seconds between two samples of the plots
const WIDEST = 0.35; // rad, to which wind-ups are enlarged
const FIRST = 0.5; // s, when the first move begins
const BUSY = 0.6; // share of the time that computing may take before perturbed arms are left out
const element = (id) => document.getElementById(id);

function made(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name in node && typeof value !== "string") node[name] = value;
    else node.setAttribute(name, value);
  }
  node.append(...children);
  return node;
}

class Page {
  constructor(settings, simulation) {
    this.s = settings;
    this.simulation = simulation;
    this.view = new View(simulation);
    this.ours = new ArmDrawing(this.view, element("ours"), 0, "ours");
    this.theirs = new ArmDrawing(this.view, element("theirs"), 1, "rival");
    for (const drawing of [this.ours, this.theirs]) drawing.canvas.style.aspectRatio = String(this.view.aspect());
    this.goal = [...settings.goal];
    this.joint = 0;
    this.running = false;
    this.speed = 1;
    this.due = 0; // seconds that are still to be computed
    this.wanderAt = FIRST;
    this.ghosts = 0; // perturbed pairs that are asked for
    this.load = 0;
    this.frames = 0;
    this.held = null;
    this.factor = 1;
    this.pushUntil = -1;
    this.said = "";
    this.saidAt = -1;
    this.sliders = new Map();
    this.history = new History(["goal", "ours", "theirs", "oursInput", "theirsInput", "oursWindup", "theirsWindup", "low", "high"], Math.round(2.5 * SHOWN / CHUNK));
    this.angle = settings.slides.map((slides) => (slides ? ["mm", 1e3] : settings.degrees ? ["°", 180 / Math.PI] : ["rad", 1]));
    this.makePlots();
    this.makeToolbar();
    this.makeGoals();
    this.makeConditions();
    this.makeTolerances();
    this.makePerturbed();
    for (const drawing of [this.ours, this.theirs]) this.makePointer(drawing);
    this.makeKeys();
    this.palette = colours();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => (this.palette = colours()));
    if (!settings.commanded) this.noCommand();
    this.reset();
    this.run(!matchMedia("(prefers-reduced-motion: reduce)").matches);
    requestAnimationFrame((now) => this.frame(now));
  }

  // Parts of the page ----------------------------------------------------------------------------------
  makePlots() {
    const rival = () => this.simulation.pdOn, lines = (what) => [
      { name: `theirs${what}`, colour: "rival", width: 1.75, dash: [7, 3], shown: rival },
      { name: `ours${what}`, colour: "ours", width: 2 },
    ];
    const goal = { name: "goal", colour: "goal", width: 1.5, dash: [2, 3], shown: () => this.s.commanded };
    const edges = ["low", "high"].map((name) => ({ name, colour: "ink", width: 1, shown: () => this.simulation.pairs > 0 }));
    this.plots = [
      new Plot(element("position-plot"), [goal, ...edges, ...lines("")], SHOWN, 2),
      new Plot(element("input-plot"), lines("Input"), SHOWN, 0.1),
      new Plot(element("windup-plot"), lines("Windup"), SHOWN, 0.2),
    ];
    const select = element("joint");
    this.s.joints.forEach((name, j) => select.append(made("option", { value: String(j) }, name)));
    element("joint-choice").hidden = this.s.joints.length < 2;
    select.addEventListener("change", () => this.chooseJoint(Number(select.value)));
    this.chooseJoint(0);
  }

  chooseJoint(joint) {
    this.joint = joint;
    element("joint").value = String(joint);
    this.history.clear();
    const [unit] = this.angle[joint];
    this.plots[0].least = this.plots[2].least = 2;
    if (unit === "rad") this.plots[0].least = this.plots[2].least = 0.03;
    this.plots[2].least /= 10;
    this.plots[1].limits = [this.s.lower[joint], this.s.upper[joint]].filter((limit) => limit !== null);
  }

  makeToolbar() {
    element("pause").addEventListener("click", () => this.run(!this.running));
    element("reset").addEventListener("click", () => this.reset());
    element("push").addEventListener("click", () => this.push());
    element("moves").addEventListener("change", () => this.chooseMoves());
    element("speed").addEventListener("change", (event) => (this.speed = Number(event.target.value)));
    element("wander").addEventListener("change", () => (this.wanderAt = this.simulation.time));
    element("ghosts").addEventListener("change", (event) => this.setGhosts(event.target.checked ? this.wantedGhosts : 0));
    element("rival").addEventListener("change", (event) => {
      this.simulation.pdOn = event.target.checked;
      element("rival-figure").hidden = !event.target.checked;
      element("arms").classList.toggle("single", !event.target.checked);
      if (event.target.checked) this.again(1);
    });
  }

  // The PD's arms begin again where the others are: they were not computed meanwhile.
  again(first) {
    for (let k = first; k < 2 * (this.s.pairs + 1); k += 2) {
      this.simulation.states[k].set(this.simulation.states[k - 1]);
    }
  }

  slider(where, { key, label, low, high, step, value, text, change, hint }) {
    const input = made("input", { type: "range", id: `slider-${key}`, min: String(low), max: String(high), step: String(step) });
    const output = made("output", { for: input.id });
    const box = made("div", { class: "slider" }, made("label", { for: input.id }, label), output, input);
    if (hint) box.append(made("small", {}, hint));
    const show = () => {
      output.textContent = text(Number(input.value));
      input.setAttribute("aria-valuetext", output.textContent);
    };
    input.value = String(value);
    input.addEventListener("input", () => {
      change(Number(input.value));
      show();
    });
    show();
    where.append(box);
    const control = { input, show, first: value, set: (v) => {
      input.value = String(v);
      show();
    } };
    this.sliders.set(key, control);
    return control;
  }

  makeGoals() {
    const where = element("goals");
    this.goalSliders = this.s.joints.map((name, j) => {
      const [unit, scale] = this.angle[j];
      return this.slider(where, {
        key: `goal-${j}`, label: this.s.joints.length > 1 ? name : "Goal of the link", low: Math.ceil(10 * scale * this.s.low[j]) / 10, high: Math.floor(10 * scale * this.s.high[j]) / 10,
        step: unit === "rad" ? 0.01 : 0.1, value: scale * this.goal[j], text: (v) => withUnit(Number(v.toFixed(unit === "rad" ? 2 : 1)), unit),
        change: (v) => this.setGoal(this.goal.map((q, k) => (k === j ? v / scale : q))),
      });
    });
    where.append(made("p", { class: "hint" }, this.view.planar ? "Or click in the picture, or drag the ring." : "Or click in the picture, or drag the ring. Drag beside the arm to turn the view."));
  }

  makeConditions() {
    const where = element("conditions"), s = this.s, { period } = s;
    for (const load of s.payloads) {
      const place = s.numbers.indexOf(load.name);
      this.slider(where, {
        key: load.name, label: s.payloads.length > 1 ? `Payload at ${load.joint}` : "Payload", low: 0, high: load.high, step: load.high / 100, value: load.value,
        text: (v) => `${significant(v)} kg`, change: (v) => this.setNumber(place, v),
        hint: load.lower < load.upper ? `Designed for ${significant(load.lower)} to ${significant(load.upper)} kg.` : `Designed for ${significant(load.value)} kg.`,
      });
    }
    const first = s.noise.find((deviation) => deviation > 0);
    if (first !== undefined) {
      const k = s.noise.indexOf(first), measured = s.measured_units[k] === "rad" ? ["mrad", 1e3] : s.measured_units[k] === "m" ? ["mm", 1e3] : [s.measured_units[k], 1];
      this.slider(where, {
        key: "noise", label: "Measurement noise", low: 0, high: 30, step: 0.5, value: 1,
        text: (v) => `${digits(v)} × (${significant(v * first * measured[1], 2)} ${measured[0]} rms)`,
        change: (v) => this.set(() => (this.simulation.noise = v)), hint: "1 × is what the design states.",
      });
      this.set(() => (this.simulation.noise = 1));
    }
    this.slider(where, {
      key: "latency", label: "Latency", low: 0, high: Math.min(s.queue, s.latency + 20), step: 1, value: s.latency,
      text: (v) => `${v} ${v === 1 ? "sample" : "samples"} (${significant(v * period * 1e3)} ms)`,
      change: (v) => this.set(() => (this.simulation.latency = v)), hint: `From measurement to effect. The controller expects ${s.latency}.`,
    });
    const box = made("input", { type: "checkbox", id: "sensor" });
    box.addEventListener("change", () => this.set(() => (this.simulation.sensing = !box.checked)));
    where.append(made("label", { class: "inline" }, box, "Cut the sensors"));
  }

  makeTolerances() {
    const where = element("tolerances"), groups = new Map();
    where.append(made("p", { class: "hint" }, this.s.stated ? "Both arms change, and nobody tells the controllers. Sliders go to three times the stated tolerance." : "Both arms change, and nobody tells the controllers. The robot states no tolerances: sliders go to ± 30 %."));
    for (const row of this.s.sliders) groups.set(row.quantity, [...(groups.get(row.quantity) || []), row]);
    let shown = where;
    let count = 0;
    for (const [quantity, rows] of groups) {
      if (count++ === 3) {
        shown = made("details", {}, made("summary", {}, groups.size > 4 ? `${groups.size - 3} more numbers` : "One more number"));
        where.append(shown);
      }
      if (rows.length === 1) this.tolerance(shown, rows[0], rows[0].joint && this.s.joints.length > 1 ? `${quantity}, ${rows[0].joint}` : quantity);
      else this.quantity(shown, quantity, rows);
    }
    const nominal = made("button", { type: "button", id: "nominal" }, "Nominal arm again");
    nominal.addEventListener("click", () => this.nominal());
    where.append(made("p", { class: "hint" }), nominal);
  }

  tolerance(where, row, label) {
    const place = this.s.numbers.indexOf(row.name), value = (t) => Math.max(row.low, row.value + t * (t < 0 ? row.value - row.lower : row.upper - row.value));
    const percent = (v) => (row.value ? ` (${v >= row.value ? "+" : "−"}${digits(Math.abs(100 * (v / row.value - 1)), 2)} %)` : "");
    return this.slider(where, {
      key: row.name, label: label[0].toUpperCase() + label.slice(1), low: -3, high: 3, step: 0.05, value: 0,
      text: (t) => `${significant(value(t))} ${row.unit}${t ? percent(value(t)) : ""}${Math.abs(t) > 1 ? ", beyond its tolerance" : ""}`,
      change: (t) => this.setNumber(place, value(t)),
    });
  }

  // One slider for a quantity of all joints, and one each behind it.
  quantity(where, quantity, rows) {
    const each = [];
    const all = this.slider(where, {
      key: `all-${quantity.replaceAll(" ", "-")}`, label: `${quantity[0].toUpperCase()}${quantity.slice(1)}, all joints`, low: -3, high: 3, step: 0.05, value: 0,
      text: (t) => (t ? `${t > 0 ? "+" : "−"}${digits(Math.abs(t), 2)} × tolerance` : "nominal"),
      change: (t) => each.forEach((control) => {
        control.set(t);
        control.input.dispatchEvent(new Event("input"));
      }),
    });
    const details = made("details", {}, made("summary", {}, `${quantity}, joint by joint`));
    where.append(details);
    for (const row of rows) each.push(this.tolerance(details, row, row.joint));
    return all;
  }

  makePerturbed() {
    const where = element("perturbed"), s = this.s;
    this.wantedGhosts = s.pairs;
    if (!this.simulation.uncertain.length) {
      where.hidden = true;
      element("ghosts").closest("label").hidden = true;
      return;
    }
    this.slider(where, {
      key: "count", label: "How many", low: 1, high: s.pairs, step: 1, value: s.pairs, text: (v) => String(v),
      change: (v) => {
        this.wantedGhosts = v;
        if (element("ghosts").checked) this.setGhosts(v);
      },
    });
    this.slider(where, {
      key: "spread", label: "Spread", low: 1, high: 3, step: 0.1, value: 1, text: (v) => `${digits(v, 2)} × tolerance`,
      change: (v) => this.set(() => {
        this.simulation.spread = v;
        this.simulation.setNumbers();
      }), hint: "The thin lines in the uppermost plot are the outermost of this design's arms.",
    });
    const seed = made("input", { type: "number", id: "seed", min: "0", max: "999999", step: "1", value: "1" });
    seed.addEventListener("change", () => this.set(() => {
      const value = Math.round(Number(seed.value));
      this.simulation.seed = Number.isFinite(value) ? Math.min(999999, Math.max(0, value)) : 1;
      seed.value = String(this.simulation.seed);
      this.simulation.setNumbers();
      this.simulation.join(1);
    }));
    where.append(made("label", { class: "inline" }, "Seed ", seed), made("p", { class: "hint" }, "Each has random numbers within the tolerances, about those of the sliders, and the same controller. The same seed makes the same arms."));
  }

  noCommand() {
    element("rival-note").hidden = element("moves").closest("label").hidden = true;
    element("goals").replaceChildren(made("legend", {}, "Goal"), made("p", { class: "hint" }, "This controller takes no command: it holds one pose."));
    element("wander").closest("label").hidden = true;
    element("wander").checked = false;
    this.goalSliders = [];
  }

  // What is set ------------------------------------------------------------------------------------------
  set(change) {
    change();
    this.simulation.setConditions();
  }

  setNumber(place, value) {
    this.simulation.values[place] = value;
    this.simulation.setNumbers();
  }

  nominal() {
    for (const [key, control] of this.sliders) {
      if (!key.startsWith("goal-") && key !== "count" && key !== "spread") {
        control.set(control.first);
        control.input.dispatchEvent(new Event("input"));
      }
    }
    element("sensor").checked = false;
    this.set(() => (this.simulation.sensing = true));
  }

  setGoal(pose, own = true, fast = 0) {
    if (!this.s.commanded) return;
    this.goal = pose.map((q, j) => Math.max(this.s.low[j], Math.min(this.s.high[j], q)));
    if (own) element("wander").checked = false;
    this.goalSliders.forEach((control, j) => control.set(this.angle[j][1] * this.goal[j]));
    this.view.include(this.goal);
    this.simulation.goTo(this.goal, fast);
  }

  // To and fro as fast as springs vibrate, beside a PD that holds its motors stiffly; or smoothly, beside the tuned PD.
  chooseMoves() {
    this.setStiff(this.fast());
    this.wanderAt = this.simulation.time;
    element("wander").checked = true;
    if (!element("rival").checked) element("rival").click();
    if (!this.running) this.run(true);
  }

  fast() {
    return this.s.commanded && element("moves").value === "fast";
  }

  setStiff(on) {
    this.simulation.setStiff(on);
    element("rival-name").textContent = on ? "Stiff PD" : "PD";
    element("rival-note").textContent = on ? this.s.stiff.note : this.s.pd.note;
  }

  setGhosts(count) {
    this.simulation.pairs = count;
    this.ghosts = count;
    this.load = 0;
    this.frames = 0;
    element("ghost-note").hidden = true;
    this.simulation.join(1);
  }

  push() {
    this.simulation.pushed.set(this.s.push.map((torque, j) => (j === this.joint ? torque : 0)));
    this.pushUntil = this.simulation.time + 0.25;
    if (!this.running) this.run(true);
  }

  run(running) {
    this.running = running;
    this.due = 0;
    element("pause").textContent = running ? "Pause" : "Start";
  }

  reset() {
    this.simulation.pushed.fill(0);
    this.simulation.reset(this.s.start);
    this.view.begin();
    this.history.clear();
    this.wanderAt = FIRST;
    this.goal = [...this.s.start];
    this.goalSliders.forEach((control, j) => control.set(this.angle[j][1] * this.goal[j]));
    this.factor = this.s.magnified;
    this.showFactor();
    this.setStiff(this.fast());
    this.record();
  }

  // Pointer and keys -------------------------------------------------------------------------------------
  makePointer(drawing) {
    const { canvas } = drawing, { view, simulation } = this;
    const place = (event) => {
      const box = canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    let mode = null, last = null, moved = 0;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      view.fit(canvas);
      last = place(event);
      moved = 0;
      const tip = view.point(view.tipOf(simulation.frames(this.goal)));
      const near = simulation.lost(drawing.arm) ? null : view.nearest(last, simulation.links(drawing.arm));
      const reach = event.pointerType === "touch" ? 34 : 20;
      if (near && near.distance < reach) mode = "pull";
      else if (this.s.commanded && length(minus(last, tip)) < reach) mode = "goal";
      else mode = view.planar ? "goal" : "turn";
      if (mode === "pull") {
        this.held = { link: near.link, local: near.local, hand: near.world, arm: drawing.arm };
        simulation.hand.set(near.world);
        simulation.hold(near.link, near.local, this.s.pull / (0.35 * view.reach), this.s.pull);
        if (!this.running) this.run(true);
      } else if (mode === "goal") this.aim(last);
      canvas.focus({ preventScroll: true });
      event.preventDefault();
    });
    canvas.addEventListener("pointermove", (event) => {
      if (mode === null) return;
      const at = place(event), way = minus(at, last);
      moved += length(way);
      last = at;
      view.fit(canvas);
      if (mode === "pull") {
        this.held.hand = view.world(at, this.held.hand);
        simulation.hand.set(this.held.hand);
      } else if (mode === "goal") this.aim(at);
      else {
        view.azimuth += 0.01 * way[0];
        view.elevation = Math.max(-1.5, Math.min(1.5, view.elevation + 0.01 * way[1]));
        view.orient();
      }
    });
    const end = () => {
      if (mode === "turn" && moved < 4) this.aim(last);
      if (mode === "pull") simulation.hold(-1, null, 1, 1);
      this.held = mode = null;
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
  }

  aim(place) {
    const { view } = this, tip = view.tipOf(this.simulation.frames(this.goal));
    this.setGoal(view.inverse(view.world(place, tip), this.goal));
  }

  makeKeys() {
    document.addEventListener("keydown", (event) => {
      const field = event.target.closest("input, select, button, summary");
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const arm = event.target === element("ours") || event.target === element("theirs");
      const n = this.s.joints.length, step = this.s.slides[this.joint] ? 0.01 : (5 * Math.PI) / 180;
      const nudge = (way) => this.setGoal(this.goal.map((q, j) => (j === this.joint ? q + way * step : q)));
      const acts = {
        " ": () => !field && this.run(!this.running), r: () => !field && this.reset(), p: () => arm && this.push(),
        ArrowLeft: () => arm && nudge(-1), ArrowRight: () => arm && nudge(1),
        ArrowUp: () => arm && this.chooseJoint((this.joint + n - 1) % n), ArrowDown: () => arm && this.chooseJoint((this.joint + 1) % n),
      };
      const act = acts[event.key.length === 1 ? event.key.toLowerCase() : event.key];
      if (act && act() !== false) event.preventDefault();
    });
  }

  // The clock --------------------------------------------------------------------------------------------
  frame(now) {
    const passed = Math.min(0.1, Math.max(0, (now - (this.before ?? now)) / 1e3));
    this.before = now;
    if (this.running) this.compute(passed * this.speed, passed);
    this.draw();
    requestAnimationFrame((next) => this.frame(next));
  }

  compute(seconds, passed) {
    const sim = this.simulation, samples = Math.max(1, Math.round(CHUNK / this.s.period)), chunk = samples * this.s.period;
    const begun = performance.now();
    let computed = 0;
    this.due = Math.min(this.due + seconds, 0.2);
    while (this.due >= chunk) {
      if (performance.now() - begun > 60) {
        this.due = 0; // slower than real time: what is missed is left out
        break;
      }
      this.wander();
      if (this.pushUntil >= 0 && sim.time >= this.pushUntil) {
        sim.pushed.fill(0);
        this.pushUntil = -1;
      }
      sim.advance(samples);
      this.due -= chunk;
      computed += chunk;
      this.record();
    }
    if (computed > 0 && passed > 0) this.judgeLoad((performance.now() - begun) / 1e3 / computed);
  }

  // Seconds of computing per second shown: where it is too much, fewer perturbed arms.
  judgeLoad(cost) {
    this.frames += 1;
    this.load = this.frames < 3 ? cost : 0.9 * this.load + 0.1 * cost;
    this.computed = this.load * this.speed;
    const sim = this.simulation, most = this.ghosts, now = sim.pairs;
    if (this.frames > 40 && this.computed > BUSY && now > 0) {
      sim.pairs = Math.max(0, Math.min(now - 1, Math.floor((now * BUSY * 0.8) / this.computed)));
    } else if (this.frames > 120 && this.computed < 0.4 * BUSY && now < most) {
      sim.pairs = Math.min(most, Math.ceil(1.4 * now) + 1);
      sim.join(now + 1);
    }
    if (sim.pairs === now) return;
    this.frames = 0;
    const note = element("ghost-note"), shown = sim.pairs;
    note.hidden = shown === most;
    note.textContent = `${most} perturbed arms are too many for this computer in real time: ${shown || "none"} ${shown === 1 ? "is" : "are"} shown.`;
  }

  wander() {
    if (!element("wander").checked || this.simulation.time < this.wanderAt) return;
    const there = this.goal.every((q, j) => Math.abs(q - this.s.goal[j]) < 1e-9);
    const pose = there ? this.s.other : this.s.goal, lasts = this.fast() ? this.s.fast : this.simulation.duration(pose);
    this.setGoal(pose, false, this.fast() ? lasts : 0);
    this.wanderAt = this.simulation.time + Math.max(4, 1.5 * lasts + 2);
  }

  record() {
    const sim = this.simulation, j = this.joint, scale = this.angle[j][1], row = { time: sim.time };
    row.goal = scale * sim.command()[j];
    [["ours", 0], ["theirs", 1]].forEach(([name, arm]) => {
      const off = sim.lost(arm) || (arm === 1 && !sim.pdOn);
      row[name] = off ? NaN : scale * sim.states[arm][j];
      row[`${name}Input`] = off ? NaN : sim.inputs[arm][j];
      row[`${name}Windup`] = off ? NaN : scale * sim.windup(arm, j);
    });
    [row.low, row.high] = [Infinity, -Infinity];
    for (let k = 1; k <= sim.pairs; k++) {
      if (sim.lost(2 * k)) continue;
      row.low = Math.min(row.low, scale * sim.states[2 * k][j]);
      row.high = Math.max(row.high, scale * sim.states[2 * k][j]);
    }
    this.history.add(row);
    this.last = row;
  }

  // What is seen -----------------------------------------------------------------------------------------
  draw() {
    const sim = this.simulation;
    const payload = this.s.payloads.reduce((sum, load) => sum + sim.values[this.s.numbers.indexOf(load.name)] / (load.high || 1), 0);
    const state = { colours: this.palette, goal: this.goal, held: this.held, heldArm: this.held ? this.held.arm : -1, factor: this.factor, payload };
    this.ours.draw(state);
    if (sim.pdOn) this.theirs.draw(state);
    for (const plot of this.plots) plot.draw(this.history, Math.max(sim.time, SHOWN), this.palette);
    this.drawn = (this.drawn || 0) + 1;
    if (this.drawn % 6 === 1) this.words();
  }

  showFactor() {
    element("magnified").textContent = this.factor > 1 ? `, drawn with the wind-up ${this.factor} times larger` : "";
  }

  words() {
    const sim = this.simulation, j = this.joint, row = this.last || { goal: NaN }, [unit] = this.angle[j];
    const both = (what, u, count = 3) => `<b class="ours-text">${withUnit(row[`ours${what}`], u, count)}</b>${sim.pdOn ? `, PD <b class="rival-text">${withUnit(row[`theirs${what}`], u, count)}</b>` : ""}`;
    element("position-name").innerHTML = `Link ${both("", unit)}${this.s.commanded ? `, goal <b class="goal-text">${withUnit(row.goal, unit)}</b>` : ""}`;
    const limit = this.plots[1].limits.length ? ` (limits ${this.plots[1].limits.map((v) => digits(v)).join(" and ")})` : "";
    element("input-name").innerHTML = `${this.s.input_name} ${both("Input", this.s.effort)}${limit}`;
    element("windup-name").innerHTML = `Wind-up of the spring ${both("Windup", unit, 2)}`;
    this.status("ours-status", this.ownWords());
    this.status("rival-status", this.rivalWords());
    const text = `This design: ${this.ownWords()}. PD: ${this.rivalWords()}.`;
    if (text !== this.said && performance.now() - this.saidAt > 3000) {
      element("announce").textContent = this.said = text;
      this.saidAt = performance.now();
    }
  }

  status(id, text) {
    const node = element(id);
    if (node.textContent !== text) node.textContent = text;
    node.classList.toggle("alarm", !["on its way", "at the goal", "vibrating", "pulled away", "holds its pose"].includes(text));
  }

  atLimit(arm) {
    return this.s.joints.some((_, j) => {
      const u = this.simulation.inputs[arm][j], { lower, upper } = this.s;
      return (upper[j] !== null && u >= upper[j] - 1e-3 * Math.abs(upper[j])) || (lower[j] !== null && u <= lower[j] + 1e-3 * Math.abs(lower[j]));
    });
  }

  moving(arm) {
    if (this.held) return "pulled away";
    if (!this.s.commanded) return "holds its pose";
    const command = this.simulation.command(), links = this.simulation.links(arm);
    const off = links.map((q, j) => Math.abs(q - this.goal[j]));
    if (off.every((e, j) => e < (this.s.slides[j] ? 2e-3 : 0.02))) return "at the goal";
    const resting = command.every((q, j) => Math.abs(q - this.goal[j]) < 1e-9);
    return resting && this.s.speed.some((v) => v !== null) ? "vibrating" : "on its way";
  }

  ownWords() {
    const sim = this.simulation, name = this.s.names[String(sim.code.code_of(0))], bits = sim.code.status_of(0);
    if (sim.lost(0)) return "the arm ran away: press Reset";
    if (name === "PREDICTED") return "no measurement, it predicts";
    if (name === "STOPPED") return "no measurement for long, the output is held";
    if (name !== "OK") return this.s.codes[String(sim.code.code_of(0))];
    if (this.atLimit(0)) return "input at its limit";
    if (bits & 64) return "something blocks the arm, and it lets go";
    if (bits & 32) return "the arm is far from its command";
    if (bits & 4) return "an input was at its limit for long";
    if (bits & 2) return "an input or the arm swings while the goal rests";
    if (bits & 16) return "its estimate is in doubt";
    if (bits & 8) return "it brakes, or comes back slowly";
    if (bits & 1) return "the goal is outside of what it was designed for";
    return this.moving(0);
  }

  rivalWords() {
    const sim = this.simulation;
    if (!sim.pdOn) return "off";
    if (sim.lost(1)) return "the arm ran away: press Reset";
    if (!sim.sensing) return "no measurement, the output is held";
    return this.atLimit(1) ? "input at its limit" : this.moving(1);
  }
}

async function start() {
  try {
    const settings = JSON.parse(element("settings").textContent);
    const simulation = await Simulation.of(settings, await unpacked(element("module").textContent));
    window.livePage = new Page(settings, simulation);
  } catch (error) {
    const trouble = element("trouble");
    trouble.hidden = false;
    trouble.textContent = `The arm cannot run in this browser: ${error.message}. Browsers since 2023 can.`;
    throw error;
  }
}

start();
