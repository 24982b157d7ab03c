// The figure of a miniature: its numbers, and how it is drawn so that it reads at a hundred pixels.

const LOOP_FRAMES = 24;
const LOOP_HEADER = 16; // bytes: metres per unit, seconds, height of zero, most telling share
const DEPTH_TONES = 7; // from the farthest to the nearest limb
const PITCH = { cos: Math.cos(0.16), sin: Math.sin(0.16) }; // the camera looks down a little

const FRONT = 0.3; // m of floor before and behind the body that the picture shows

// Lengths, m of a body of 1.7 m; thicker than life, as thin limbs vanish in small pictures.
const LIMB_JOINTS = { arm: ["Shoulder", "Elbow", "Wrist", "Hand"], leg: ["Hip", "Knee", "Ankle", "Toe"] };
const LIMB_WIDTHS = { arm: [0.115, 0.095], leg: [0.15, 0.12] };
const TRUNK_WIDTH = 0.15;
const TRUNK_CORNERS = [["lShoulder", "neck"], ["rShoulder", "neck"], ["rHip", "pelvis"], ["lHip", "pelvis"]];
const HEAD_RADIUS = 0.122;
const NECK_WIDTH = 0.1;
const SKULL = 0.172; // from the neck to the middle of the skull
const GAP = 0.03; // what a part keeps free around itself where it crosses another one
const BONE_SHARES = [0.38, 0.31, 0.31]; // of trunk, thigh and shank in their sum
const ABSENT = -128; // stored of a joint that the body lacks
const GROUNDED = ["lToe", "rToe", "lAnkle", "rAnkle", "pelvis", "neck"];

class Loop {
  constructor(source) {
    const bytes = source instanceof Uint8Array ? source : new Uint8Array(source);
    if (bytes.length !== LOOP_HEADER + LOOP_FRAMES * VALUES) {
      throw new Error(`dousa miniature: expected ${LOOP_HEADER + LOOP_FRAMES * VALUES} bytes, got ${bytes.length}`);
    }
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    const [unit, duration, middle, still] = [0, 4, 8, 12].map((at) => view.getFloat32(at, true));
    if (![unit, duration, middle, still].every(Number.isFinite)) throw new Error("dousa miniature: damaged header");
    Object.assign(this, { duration: Math.max(duration, 0), still: Math.min(Math.max(still, 0), 1) });
    this.values = Float32Array.from(new Int8Array(bytes.buffer, bytes.byteOffset + LOOP_HEADER, LOOP_FRAMES * VALUES));
    this.absent = new Set();
    for (const name of Object.keys(JOINT)) if (this.values[3 * JOINT[name]] === ABSENT) this.absent.add(name);
    this.replaceAbsent();
    for (let k = 0; k < this.values.length; k += 1) this.values[k] = this.values[k] * unit + (k % 3 === 1 ? middle : 0);
    this.measure();
  }

  has(...names) {
    return !names.some((name) => this.absent.has(name));
  }

  // What is absent lies where some other joint is, so that it takes no room.
  replaceAbsent() {
    const some = Object.keys(JOINT).find((name) => this.has(name));
    if (!this.absent.size || some === undefined) return;
    for (let frame = 0; frame < LOOP_FRAMES; frame += 1) {
      for (const name of this.absent) {
        for (let axis = 0; axis < 3; axis += 1) {
          const at = frame * VALUES + axis;
          this.values[at + 3 * JOINT[name]] = this.values[at + 3 * JOINT[some]];
        }
      }
    }
  }

  // Size of the body against 1.7 m by its longest sight of each bone, and how much room all poses need.
  measure() {
    const bones = [["neck", "pelvis"], ["lHip", "lKnee"], ["lKnee", "lAnkle"]];
    let chain = 0;
    let seen = 0;
    for (const [index, [a, b]] of bones.entries()) {
      let longest = 0;
      if (!this.has(a, b)) continue;
      seen += BONE_SHARES[index];
      for (let frame = 0; frame < LOOP_FRAMES; frame += 1) {
        const [p, q] = [a, b].map((name) => frame * VALUES + 3 * JOINT[name]);
        const { values: v } = this;
        longest = Math.max(longest, Math.hypot(v[p] - v[q], v[p + 1] - v[q + 1], v[p + 2] - v[q + 2]));
      }
      chain += longest;
    }
    this.scale = seen ? Math.min(Math.max(chain / (1.32 * seen), 0.2), 3) : 1;
    let [wide, top] = [0.4 * this.scale, (this.absent.size ? 0.6 : 1.6) * this.scale];
    for (let k = 0; k < this.values.length; k += 3) {
      const beyond = (k % VALUES === 3 * JOINT.neck ? SKULL + HEAD_RADIUS : 0.08) * this.scale;
      wide = Math.max(wide, Math.abs(this.values[k]) + beyond);
      top = Math.max(top, this.values[k + 1] + beyond);
    }
    this.room = { wide, top };
  }

  // Joints at a share of the loop, smooth through the stored poses (Catmull and Rom).
  sample(share, out) {
    const place = Math.min(Math.max(share, 0), 1) * (LOOP_FRAMES - 1);
    const at = Math.min(Math.floor(place), LOOP_FRAMES - 2);
    const s = place - at;
    const [a, b, c, d] = [at - 1, at, at + 1, at + 2].map((k) => VALUES * Math.min(Math.max(k, 0), LOOP_FRAMES - 1));
    const [p, q] = [0.5 * s * (-1 + s * (2 - s)), 1 + 0.5 * s * s * (-5 + 3 * s)];
    const [r, t] = [0.5 * s * (1 + s * (4 - 3 * s)), 0.5 * s * s * (s - 1)];
    const { values: v } = this;
    for (let k = 0; k < VALUES; k += 1) {
      out[k] = p * v[a + k] + q * v[b + k] + r * v[c + k] + t * v[d + k];
    }
  }
}

// From the colour of far limbs to that of near ones.
function depthTones(near, far) {
  const [a, b] = [parseColour(far), parseColour(near)];
  return Array.from({ length: DEPTH_TONES }, (_, step) => mixColours(a, b, step / (DEPTH_TONES - 1)));
}

// Paints one pose; all lengths are pixels of the canvas.
class LoopPainter {
  constructor(context) {
    this.context = context;
    this.joints = new Float64Array(VALUES);
    this.first = new Float64Array(VALUES);
    this.flat = new Float64Array(VALUES); // x, y of the picture and depth, m
  }

  // colours: tones of depth, and shadow, a gradient over a circle of radius 1 about 0; fade: 0 to 1;
  // mend: 0 to 1, how far on the way from there to the first pose.
  draw(loop, share, colours, fade, mend = 0) {
    const { context } = this;
    const { width, height } = context.canvas;
    this.scale = loop.scale;
    this.has = (...names) => loop.has(...names);
    context.clearRect(0, 0, width, height);
    loop.sample(share, this.joints);
    if (mend > 0) {
      loop.sample(0, this.first);
      mixJoints(this.joints, this.first, ease(mend));
    }
    this.place(loop.room, width, height);
    context.lineCap = "round";
    context.lineJoin = "round";
    for (const part of this.collect()) this.paint(part, colours.tones[Math.round(part.tone * (DEPTH_TONES - 1))]);
    context.globalCompositeOperation = "destination-over";
    this.paintShadow(colours.shadow);
    if (fade < 1) this.weaken(fade, width, height);
    context.globalCompositeOperation = "source-over";
  }

  weaken(fade, width, height) {
    const { context } = this;
    context.globalCompositeOperation = "destination-in";
    context.globalAlpha = fade;
    context.fillStyle = "#000"; // opaque: the shadow's gradient would take everything away
    context.fillRect(0, 0, width, height);
    context.globalAlpha = 1;
  }

  place(room, width, height) {
    const tall = room.top * PITCH.cos + 2 * FRONT * PITCH.sin;
    this.pixels = Math.min((0.94 * height) / tall, (0.96 * width) / (2 * room.wide));
    this.unit = this.pixels * this.scale;
    this.middle = width / 2;
    // A wide room leaves air above and below: a little more of it above, as a floor should lie low.
    const below = 0.03 * height + 0.35 * (0.94 * height - this.pixels * tall);
    this.ground = height - below - FRONT * PITCH.sin * this.pixels;
    const { joints, flat } = this;
    for (let k = 0; k < VALUES; k += 3) this.project(joints[k], joints[k + 1], joints[k + 2], flat, k);
  }

  project(x, y, z, out, at) {
    out[at] = this.middle + this.pixels * x;
    out[at + 1] = this.ground - this.pixels * (y * PITCH.cos - z * PITCH.sin);
    out[at + 2] = y * PITCH.sin + z * PITCH.cos;
  }

  // Far parts first: limbs as chains of joints, the trunk, the head.
  collect() {
    const depth = (...names) => names.reduce((sum, name) => sum + this.flat[3 * JOINT[name] + 2], 0) / names.length;
    const trunk = depth("neck", "lHip", "rHip");
    const parts = [{ kind: "trunk", depth: trunk, tone: 0.5 }];
    if (this.has("head", "neck")) parts.push({ kind: "head", depth: depth("head", "neck"), tone: 0.67 });
    for (const side of ["l", "r"]) {
      for (const [kind, joints] of Object.entries(LIMB_JOINTS)) {
        const names = joints.map((name) => side + name).filter((name) => this.has(name));
        if (names.length < 2) continue;
        const away = depth(...names.slice(0, 3));
        const tone = Math.min(Math.max(0.5 + (away - trunk) / (0.34 * this.scale), 0), 1);
        parts.push({ kind, names, depth: away, tone });
      }
    }
    return parts.sort((a, b) => a.depth - b.depth);
  }

  paint(part, colour) {
    this.context.strokeStyle = colour;
    this.context.fillStyle = colour;
    if (part.kind === "trunk") this.paintTrunk();
    else if (part.kind === "head") this.paintHead();
    else this.paintLimb(part.names, LIMB_WIDTHS[part.kind]);
  }

  spot(name) {
    return [this.flat[3 * JOINT[name]], this.flat[3 * JOINT[name] + 1]];
  }

  trace(spots, width) {
    const { context } = this;
    context.lineWidth = width * this.unit;
    context.beginPath();
    for (const [x, y] of spots) context.lineTo(x, y);
    context.stroke();
  }

  // First it clears a little room around itself, so that it stands out on whatever lies behind.
  paintLimb(names, [upper, lower]) {
    const spots = names.map((name) => this.spot(name));
    this.context.globalCompositeOperation = "destination-out";
    this.trace(spots, lower + 2 * GAP);
    this.context.globalCompositeOperation = "source-over";
    this.trace(spots.slice(0, 2), upper);
    this.trace(spots.slice(1), lower);
  }

  paintTrunk() {
    const { context } = this;
    context.lineWidth = TRUNK_WIDTH * this.unit;
    context.beginPath();
    for (const names of TRUNK_CORNERS) {
      if (!this.has(...names)) continue;
      const [a, b] = names.map((name) => this.spot(name));
      context.lineTo(a[0] + 0.2 * (b[0] - a[0]), a[1] + 0.2 * (b[1] - a[1]));
    }
    context.closePath();
    context.fill();
    context.stroke();
  }

  // Files put the head joint anywhere from the nape to the crown: only its direction is taken.
  paintHead() {
    const { joints } = this;
    const at = (name) => [0, 1, 2].map((k) => joints[3 * JOINT[name] + k]);
    const neck = at("neck");
    const axis = unit(subtract(at("head"), neck), [0, 1, 0]);
    const skull = addScaled(neck, axis, SKULL * this.scale);
    const spot = [0, 0, 0];
    this.project(...skull, spot, 0);
    this.context.globalCompositeOperation = "destination-out";
    this.disc(spot, HEAD_RADIUS + GAP);
    this.context.globalCompositeOperation = "source-over";
    this.trace([this.spot("neck"), spot], NECK_WIDTH);
    this.disc(spot, HEAD_RADIUS);
  }

  disc([x, y], radius) {
    this.context.beginPath();
    this.context.arc(x, y, radius * this.unit, 0, 7);
    this.context.fill();
  }

  // Below the body's middle, as wide as the feet and what is above them.
  paintShadow(gradient) {
    const { context, pixels, joints } = this;
    let [x, z, spread] = [0, 0, 0];
    for (const name of GROUNDED) {
      x += joints[3 * JOINT[name]] / GROUNDED.length;
      z += joints[3 * JOINT[name] + 2] / GROUNDED.length;
    }
    for (const name of GROUNDED) spread = Math.max(spread, Math.abs(joints[3 * JOINT[name]] - x));
    const wide = Math.min(Math.max(spread + 0.14 * this.scale, 0.3 * this.scale), 1.1 * this.scale) * pixels;
    context.fillStyle = gradient;
    const [across, down] = [this.middle + pixels * x, this.ground + pixels * z * PITCH.sin];
    context.setTransform(1.2 * wide, 0, 0, 0.24 * wide + 0.04 * this.unit, across, down);
    context.beginPath();
    context.arc(0, 0, 1, 0, 7);
    context.fill();
    context.setTransform(1, 0, 0, 1, 0, 0);
  }
}
