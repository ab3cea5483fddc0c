// The arms: a thin shell around the WebAssembly module, see simulation.c. Arm 0 is this design's, arm 1 has the PD;
// arms 2k and 2k + 1 are the perturbed pair k with the same numbers.

async function unpacked(base64) {
  const bytes = Uint8Array.from(atob(base64.trim()), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

// Random numbers of [0, 1) from a whole number: the same seed gives the same arms in every browser.
function randomNumbers(seed) {
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let t = Math.imul(state ^ (state >>> 15), 1 | state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}

function halfToEven(x) {
  const low = Math.floor(x), rest = x - low;
  return rest < 0.5 || (rest === 0.5 && low % 2 === 0) ? low : low + 1;
}

const environment = {
  ...Object.fromEntries(
    ["sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "exp",
      "expm1", "log", "log1p", "pow", "hypot"].map((name) => [name, Math[name]]),
  ),
  fmod: (a, b) => a % b,
  remainder: (a, b) => a - b * halfToEven(a / b),
};

class Simulation {
  static async of(settings, bytes) {
    const { instance } = await WebAssembly.instantiate(bytes, { env: environment });
    return new Simulation(settings, instance.exports);
  }

  constructor(settings, code) {
    this.s = settings;
    this.code = code;
    this.n = settings.joints.length;
    this.states = [];
    this.inputs = [];
    this.pairs = 0; // perturbed pairs that are computed
    this.pdOn = true;
    this.stiff = false; // whether the PD is the stiff one
    this.seed = 1;
    this.spread = 1; // of the perturbed arms, in tolerances
    this.noise = 0;
    this.latency = settings.latency;
    this.sensing = true;
    this.time = 0;
    this.values = Float64Array.from(settings.nominal); // of the two arms, by the sliders
    const count = settings.numbers.length;
    for (let k = 0; k < 2 * (settings.pairs + 1); k++) {
      this.states.push(this.view(code.state_at(k), settings.states));
      this.inputs.push(this.view(code.input_at(k), this.n));
    }
    this.numbers = this.states.map((_, k) => this.view(code.numbers_at(k), count));
    this.wanted = this.view(code.wanted_at(), this.n);
    this.pushed = this.view(code.pushed_at(), this.n);
    this.heldPoint = this.view(code.held_point(), 3);
    this.hand = this.view(code.hand_at(), 3);
    this.force = this.view(code.force_at(), 3);
    this.scratch = this.view(code.scratch_at(), 15 * this.n);
    this.poseIn = this.view(code.scratch_at() + 8 * 15 * this.n, this.n);
    this.uncertain = [...settings.sliders, ...settings.payloads.filter((p) => p.lower < p.upper)].map((row) => ({
      place: settings.numbers.indexOf(row.name), value: row.value, lower: row.lower, upper: row.upper, low: row.low,
    }));
    this.setNumbers(true);
    this.reset(settings.start);
  }

  view(place, count) {
    return new Float64Array(this.code.memory.buffer, place, count);
  }

  // Numbers of all arms: the sliders', and about them the perturbed ones within the tolerances.
  setNumbers(nominal = false) {
    for (let k = 0; k <= this.s.pairs; k++) {
      const row = Float64Array.from(this.values);
      if (k > 0) {
        const random = randomNumbers(this.seed * 1009 + k);
        for (const p of this.uncertain) {
          const drawn = this.spread * (p.lower + (p.upper - p.lower) * random() - p.value);
          row[p.place] = Math.max(row[p.place] + drawn, p.low, p.low === 0 ? 0 : -Infinity);
        }
      }
      for (const arm of [2 * k, 2 * k + 1]) {
        this.numbers[arm].set(row);
        this.code.set_numbers(arm);
      }
    }
    if (nominal) this.code.set_nominal();
    this.setConditions();
  }

  setConditions() {
    const [own, ghosts] = this.s.steps;
    this.code.set_conditions(this.noise, this.latency, this.sensing ? 1 : 0, own, ghosts);
  }

  // All arms at rest at a pose, their controllers as at the start.
  reset(pose) {
    this.wanted.set(pose);
    this.code.set_command();
    for (let k = 0; k < 2 * (this.s.pairs + 1); k++) this.code.begin(k, this.seed);
    this.time = 0;
  }

  // Perturbed pairs from one number on go on from where the two arms are.
  join(first) {
    for (let k = 2 * first; k < 2 * (this.s.pairs + 1); k++) this.code.join(k, this.seed);
  }

  // Seconds that a motion of the command to a pose takes; 0 for a jump.
  duration(pose) {
    const from = this.command();
    let longest = 0;
    pose.forEach((q, j) => {
      const speed = this.s.speed[j];
      if (speed !== null) longest = Math.max(longest, (1.875 * Math.abs(q - from[j])) / speed);
    });
    return longest > 0 || this.s.shortest > 0 ? Math.max(longest, this.s.shortest) : 0;
  }

  // Both commands go to a pose. Where that of this design jumps, the PD's takes a time of its own; `fast`: in so many
  // seconds, whatever the speed.
  goTo(pose, fast = 0) {
    const usual = this.duration(pose), length = fast && usual ? fast : usual, from = this.links(1);
    const way = Math.max(...pose.map((q, j) => Math.abs(q - from[j]) / this.s.travel[j]));
    this.wanted.set(pose);
    this.code.set_motion(length, fast || length || Math.max(0.1, this.s.pd.time * Math.sqrt(way)));
  }

  setStiff(on) {
    this.stiff = on;
    this.code.set_stiff(on ? 1 : 0);
  }

  command() {
    this.code.command_now(this.poseIn.byteOffset);
    return Array.from(this.poseIn);
  }

  advance(samples) {
    this.code.advance(samples, this.pairs, this.pdOn ? this.pairs + 1 : 0);
    this.time += samples * this.s.period;
  }

  links(arm) {
    return Array.from(this.states[arm].subarray(0, this.n));
  }

  // Where a link would be without twist of the springs: its motor, of coupled joints T⁻¹ θ; itself without a spring.
  motor(arm, joint) {
    return this.s.back[joint].reduce((sum, share, k) => sum + share * this.states[arm][this.s.motors[k]], 0);
  }

  windup(arm, joint) {
    return this.motor(arm, joint) - this.states[arm][joint];
  }

  // Rotation, origin and axis of each link at a pose.
  frames(pose) {
    this.poseIn.set(pose);
    this.code.pose_of(this.poseIn.byteOffset, this.scratch.byteOffset);
    return this.read();
  }

  motorFrames(arm, joint, factor) {
    this.code.motor_pose(arm, joint, factor, this.scratch.byteOffset);
    return this.read();
  }

  read() {
    const frames = [];
    for (let i = 0; i < this.n; i++) {
      const row = this.scratch.subarray(15 * i, 15 * i + 15);
      frames.push({ turn: Array.from(row.subarray(0, 9)), at: Array.from(row.subarray(9, 12)), axis: Array.from(row.subarray(12, 15)) });
    }
    return frames;
  }

  hold(link, point, stiffness, limit) {
    if (link >= 0) this.heldPoint.set(point);
    this.code.hold(link, stiffness, limit);
  }

  lost(arm) {
    return this.code.lost(arm) !== 0;
  }
}
