// The arm of a run on a canvas: links, and beside them where the motors hold them, which shows the wind-up of the springs.
const floats = (text) => {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Float32Array(bytes.buffer);
};

export default {
  template: `
    <figure class="studio-figure studio-arm">
      <figcaption><span class="studio-figure-title">{{ title }}</span>
        <span class="studio-key"><span class="studio-swatch line" style="--swatch: var(--studio-link)"></span>link</span>
        <span class="studio-key"><span class="studio-swatch line" style="--swatch: var(--studio-motor)"></span>motor</span>
        <span class="studio-key"><span class="studio-swatch line" style="--swatch: var(--studio-faint)"></span>goal</span>
      </figcaption>
      <canvas ref="canvas" role="img" :aria-label="description" @pointerdown="grab" @pointermove="turn" @pointerup="release" @pointercancel="release"></canvas>
      <div class="studio-arm-bar">
        <button type="button" class="studio-button" @click="toggle">{{ playing ? 'Pause' : 'Play' }}</button>
        <label>Time <input type="range" min="0" max="1000" step="1" :value="place" @input="seek" aria-label="Time of the replay"></label>
        <label>Wind-up × {{ gain }} <input type="range" min="0" :max="factors.length - 1" step="1" :value="Math.max(0, factors.indexOf(gain))" @input="magnify" aria-label="Magnification of the wind-up"></label>
        <span class="studio-clock">{{ clock }}</span>
      </div>
    </figure>`,
  props: { title: String },
  data: () => ({ playing: true, gain: 1, factors: [1], place: 0, clock: "", description: "no run yet" }),
  created() {
    this.run = null;
    this.at = 0;
    this.yaw = 0.45;
    this.pitch = 0.22;
    this.turned = false;
    this.chosen = false; // by hand: until then each run says how much larger its wind-up is drawn
  },
  mounted() {
    this.playing = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.observer = new ResizeObserver(() => this.paint());
    this.observer.observe(this.$refs.canvas);
    this.scheme = new MutationObserver(() => this.paint());
    this.scheme.observe(document.body, { attributes: true, attributeFilter: ["class"] });
    this.last = performance.now();
    this.frame = requestAnimationFrame(this.tick);
  },
  unmounted() {
    cancelAnimationFrame(this.frame);
    this.observer.disconnect();
    this.scheme.disconnect();
  },
  methods: {
    show(data) {
      const run = { ...data, time: floats(data.time), links: floats(data.links), motors: floats(data.motors), goal: floats(data.goal) };
      if (!run.time.length) return;
      run.points = run.goal.length / 3;
      this.run = run;
      this.description = data.description || this.description;
      this.factors = data.factors;
      if (!this.chosen) this.gain = data.magnified;
      this.frameOf(run);
      if (data.restart) this.at = 0;
      this.paint();
    },
    // Scale, and the direction from which the arm is seen.
    frameOf(run) {
      const low = [0, 0, 0], high = [0, 0, 0];
      let reach = 1e-6;
      const drawn = [run.links, run.goal, this.magnified(run)];
      for (const array of drawn)
        for (let k = 0; k < array.length; k += 1) {
          const axis = k % 3;
          low[axis] = Math.min(low[axis], array[k]);
          high[axis] = Math.max(high[axis], array[k]);
        }
      const centre = [0, 1, 2].map((axis) => (low[axis] + high[axis]) / 2);
      for (const array of drawn)
        for (let k = 0; k < array.length; k += 3)
          reach = Math.max(reach, Math.hypot(array[k] - centre[0], array[k + 1] - centre[1], array[k + 2] - centre[2]));
      run.centre = centre;
      run.reach = reach;
      if (this.turned) return;
      // along the axes of the joints, a little from the side; an upright one from above
      const [x, y, z] = run.normal || [0, -1, 0];
      [this.yaw, this.pitch] = Math.abs(z) > 0.9 ? [0.15, 1.15] : [Math.atan2(x, -y) + 0.4, 0.18];
    },
    tick(now) {
      const passed = Math.min((now - this.last) / 1000, 0.1);
      this.last = now;
      if (this.run && this.playing && !document.hidden) {
        const end = this.run.time[this.run.time.length - 1];
        this.at = this.at + passed > end + 0.7 ? 0 : this.at + passed;
        this.paint();
      }
      this.frame = requestAnimationFrame(this.tick);
    },
    magnify(event) {
      this.chosen = true;
      this.gain = this.factors[Number(event.target.value)];
      if (this.run) this.frameOf(this.run);
      this.paint();
    },
    toggle() {
      this.playing = !this.playing;
    },
    seek(event) {
      if (!this.run) return;
      this.playing = false;
      this.at = (Number(event.target.value) / 1000) * this.run.time[this.run.time.length - 1];
      this.paint();
    },
    grab(event) {
      this.from = [event.clientX, event.clientY];
      event.target.setPointerCapture(event.pointerId);
    },
    turn(event) {
      if (!this.from) return;
      this.turned = true;
      this.yaw -= 0.01 * (event.clientX - this.from[0]);
      this.pitch = Math.max(-1.5, Math.min(1.5, this.pitch + 0.01 * (event.clientY - this.from[1])));
      this.from = [event.clientX, event.clientY];
      this.paint();
    },
    release() {
      this.from = null;
    },
    // Points of one instant, between two pictures of the run.
    now(array) {
      const { time, points } = this.run, size = 3 * points;
      let k = 0;
      while (k < time.length - 2 && time[k + 1] < this.at) k += 1;
      const next = Math.min(k + 1, time.length - 1), span = time[next] - time[k] || 1;
      const share = Math.max(0, Math.min(1, (this.at - time[k]) / span));
      return Float32Array.from({ length: size }, (_, i) => array[k * size + i] + share * (array[next * size + i] - array[k * size + i]));
    },
    paint() {
      const canvas = this.$refs.canvas;
      if (!canvas || !canvas.clientWidth) return;
      const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
      if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(height * ratio);
      }
      const pen = canvas.getContext("2d"), style = getComputedStyle(canvas);
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      pen.clearRect(0, 0, width, height);
      const colour = (name) => style.getPropertyValue(`--studio-${name}`).trim();
      if (!this.run) {
        [pen.font, pen.fillStyle, pen.textAlign, pen.textBaseline] = ["12px system-ui, sans-serif", colour("text"), "center", "middle"];
        pen.fillText(this.description, width / 2, height / 2);
        return;
      }
      const scale = (0.42 * Math.min(width, height)) / this.run.reach;
      const [cy, sy, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
      const project = (points, k) => {
        const [x, y, z] = [0, 1, 2].map((axis) => points[3 * k + axis] - this.run.centre[axis]);
        const across = cy * x + sy * y, away = -sy * x + cy * y;
        return [width / 2 + scale * across, height / 2 - scale * (cp * z + sp * away)];
      };
      const end = this.run.time[this.run.time.length - 1];
      this.place = Math.round((1000 * Math.min(this.at, end)) / end);
      this.clock = `${Math.min(this.at, end).toFixed(2)} s`;
      this.ground(pen, colour, project);
      const links = this.now(this.run.links), motors = this.now(this.run.motors);
      const wound = this.wound(links, motors);
      this.lines(pen, this.run.goal, project, colour("faint"), 2, [5, 4]);
      this.fans(pen, links, wound, project, colour("motor"));
      this.lines(pen, links, project, colour("link"), Math.max(5, 0.035 * Math.min(width, height)), []);
      this.lines(pen, wound, project, colour("motor"), 2.5, []);
      this.joints(pen, links, wound, project, colour);
    },
    // Where the motors would hold the links with `gain` times their wind-up, each link as long as it is.
    wound(links, motors) {
      const found = Float32Array.from(links);
      this.each((from, to) => {
        const own = [0, 1, 2].map((axis) => links[3 * to + axis] - links[3 * from + axis]);
        const far = own.map((value, axis) => value + this.gain * (motors[3 * to + axis] - motors[3 * from + axis] - value));
        const size = Math.hypot(...own) / (Math.hypot(...far) || 1);
        for (const axis of [0, 1, 2]) found[3 * to + axis] = links[3 * from + axis] + size * far[axis];
      });
      return found;
    },
    // `wound` at all instants of a run.
    magnified(run) {
      const size = 3 * run.points, found = new Float32Array(run.links.length);
      for (let k = 0; k < found.length; k += size)
        found.set(this.wound(run.links.subarray(k, k + size), run.motors.subarray(k, k + size)), k);
      return found;
    },
    ground(pen, colour, project) {
      const r = 1.1 * this.run.reach, points = [];
      for (let k = 0; k <= 48; k += 1) points.push(r * Math.cos((k * Math.PI) / 24), r * Math.sin((k * Math.PI) / 24), 0);
      pen.strokeStyle = colour("grid");
      pen.lineWidth = 1;
      pen.beginPath();
      for (let k = 0; k <= 48; k += 1) pen.lineTo(...project(points, k));
      pen.stroke();
      pen.beginPath();
      for (const k of [0, 12]) {
        pen.moveTo(...project(points, k));
        pen.lineTo(...project(points, k + 24));
      }
      pen.stroke();
    },
    // Each link has `counts` points: its joint, then what it carries.
    each(act) {
      let first = 0;
      for (const count of this.run.counts) {
        for (let k = 1; k < count; k += 1) act(first, first + k);
        first += count;
      }
    },
    lines(pen, points, project, colour, width, dash) {
      pen.strokeStyle = colour;
      pen.lineWidth = width;
      pen.lineCap = "round";
      pen.setLineDash(dash);
      pen.beginPath();
      this.each((from, to) => {
        pen.moveTo(...project(points, from));
        pen.lineTo(...project(points, to));
      });
      pen.stroke();
      pen.setLineDash([]);
    },
    fans(pen, links, wound, project, colour) {
      pen.fillStyle = colour;
      pen.globalAlpha = 0.25;
      this.each((from, to) => {
        pen.beginPath();
        for (const [points, k] of [[links, from], [links, to], [wound, to], [wound, from]]) pen.lineTo(...project(points, k));
        pen.fill();
      });
      pen.globalAlpha = 1;
    },
    joints(pen, links, wound, project, colour) {
      let first = 0;
      for (const count of this.run.counts) {
        const [x, y] = project(links, first);
        pen.beginPath();
        pen.arc(x, y, 8, 0, 2 * Math.PI);
        pen.fillStyle = colour("ground");
        pen.fill();
        pen.lineWidth = 3;
        pen.strokeStyle = colour("motor");
        pen.stroke();
        first += count;
      }
    },
  },
};
