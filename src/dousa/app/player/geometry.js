// Numbers: stored figures, the camera, outlines. No drawing, no page.

function decodeBytes(text) {
  const raw = atob(text);
  const bytes = new Uint8Array(raw.length);
  for (let k = 0; k < raw.length; k += 1) bytes[k] = raw.charCodeAt(k);
  return bytes.buffer; // little-endian, as every machine with a browser is
}

const MILLIMETRE = 0.001;
const VALUES = 60; // 20 joints, x y z

const JOINTS = [
  ["pelvis", "spine", "neck", "head"],
  ["lShoulder", "lElbow", "lWrist", "lHand", "rShoulder", "rElbow", "rWrist", "rHand"],
  ["lHip", "lKnee", "lAnkle", "lToe", "rHip", "rKnee", "rAnkle", "rToe"],
].flat();
const JOINT = Object.fromEntries(JOINTS.map((name, index) => [name, index]));

// Of a way from 0 to 1, slow at both ends.
const ease = (share) => share * share * (3 - 2 * share);

function mixJoints(joints, others, share) {
  for (let k = 0; k < VALUES; k += 1) joints[k] += share * (others[k] - joints[k]);
}

// One figure over time; `sample` writes joints in m about the hips' middle into `out` and returns the way gone.
class Clip {
  constructor(data, rate) {
    this.rate = rate;
    this.nFrames = data.n_frames;
    this.positions = new Int16Array(decodeBytes(data.positions));
    this.path = new Int32Array(decodeBytes(data.path));
    this.scale = data.stature / 1.5;
    this.absent = new Set(data.absent ?? []); // joints that the body lacks: their positions mean nothing
    if (this.positions.length !== this.nFrames * VALUES) throw new Error("dousa player: positions do not fit n_frames");
    this.measure();
  }

  // How much room the figure needs: radius and height in m that hold nearly all frames, the way's bounds.
  measure() {
    const every = Math.max(1, Math.floor(this.nFrames / 600));
    const reaches = [];
    this.top = this.absent.size ? 0.5 * this.scale : 1.2 * this.scale;
    for (let frame = 0; frame < this.nFrames; frame += every) {
      let far = 0;
      for (let joint = 0; joint < VALUES / 3; joint += 1) {
        if (this.absent.has(joint)) continue;
        const k = frame * VALUES + 3 * joint;
        const beyond = joint === JOINT.head ? 0.2 : 0.1; // skull over its joint, fingers over the hand's
        far = Math.max(far, Math.hypot(this.positions[k], this.positions[k + 2]) * MILLIMETRE);
        this.top = Math.max(this.top, this.positions[k + 1] * MILLIMETRE + beyond * this.scale);
      }
      reaches.push(far);
    }
    reaches.sort((a, b) => a - b);
    this.reach = Math.max(0.5, reaches[Math.floor(0.96 * (reaches.length - 1))]) + 0.08;
    const [low, high] = [[Infinity, Infinity], [-Infinity, -Infinity]];
    for (let k = 0; k < this.path.length; k += 1) {
      low[k % 2] = Math.min(low[k % 2], this.path[k] * MILLIMETRE);
      high[k % 2] = Math.max(high[k % 2], this.path[k] * MILLIMETRE);
    }
    this.bounds = { low, high };
  }

  // The same recording grew: what the picture shows of the floor does not become less.
  keepRoom(before) {
    if (!before) return;
    this.reach = Math.max(this.reach, before.reach);
    this.top = Math.max(this.top, before.top);
  }

  sample(time, out) {
    const place = Math.min(Math.max(time * this.rate, 0), this.nFrames - 1);
    const before = Math.floor(place);
    const after = Math.min(before + 1, this.nFrames - 1);
    const share = place - before;
    const [a, b] = [before * VALUES, after * VALUES];
    for (let k = 0; k < VALUES; k += 1) {
      out[k] = MILLIMETRE * ((1 - share) * this.positions[a + k] + share * this.positions[b + k]);
    }
    return this.placeAt(place);
  }

  placeAt(place) {
    const before = Math.min(Math.max(Math.floor(place), 0), this.nFrames - 1);
    const after = Math.min(before + 1, this.nFrames - 1);
    const share = Math.min(Math.max(place - before, 0), 1);
    const mix = (k) => MILLIMETRE * ((1 - share) * this.path[2 * before + k] + share * this.path[2 * after + k]);
    return [mix(0), mix(1)];
  }

  // Mean place over two seconds on either side: what a camera follows without shaking.
  smoothPlace(time) {
    const sum = [0, 0];
    for (let k = -4; k <= 4; k += 1) {
      const [x, z] = this.placeAt((time + k / 2) * this.rate);
      sum[0] += x / 9;
      sum[1] += z / 9;
    }
    return sum;
  }
}

// Reference times; a negative entry -1 - ms says that there is no counterpart and which moment is the nearest.
class Match {
  constructor(text, rate) {
    this.milliseconds = new Int32Array(decodeBytes(text));
    this.rate = rate;
  }

  at(time) {
    const last = this.milliseconds.length - 1;
    const place = Math.min(Math.max(time * this.rate, 0), last);
    const before = this.milliseconds[Math.floor(place)];
    const after = this.milliseconds[Math.min(Math.floor(place) + 1, last)];
    const nearest = this.milliseconds[Math.round(place)];
    const seen = nearest >= 0;
    // A jump (a figure left out or done again) is not drawn as a rush through what lies between.
    if (before >= 0 && after >= 0 && Math.abs(after - before) < 500) {
      const share = place - Math.floor(place);
      return { time: MILLIMETRE * ((1 - share) * before + share * after), seen: true };
    }
    return { time: MILLIMETRE * (seen ? nearest : -1 - nearest), seen };
  }
}

const VIEWS = {
  front: { yaw: 0.0, pitch: 0.1 },
  flank: { yaw: Math.PI / 2, pitch: 0.1 },
  top: { yaw: 0.0, pitch: 1.5 },
};

// Perspective from a distance, turned about the figure. `frame` fits a box of the world into a rectangle.
class Camera {
  constructor() {
    this.reset();
  }

  reset() {
    Object.assign(this, VIEWS.front, { yaw: 0.35, pitch: 0.16, zoom: 1 });
  }

  look(name) {
    Object.assign(this, VIEWS[name]);
  }

  turn(yaw, pitch) {
    this.yaw = Math.atan2(Math.sin(this.yaw + yaw), Math.cos(this.yaw + yaw));
    this.pitch = Math.min(Math.max(this.pitch + pitch, -0.25), 1.55);
  }

  scaleBy(factor) {
    const before = this.zoom;
    this.zoom = Math.min(Math.max(this.zoom * factor, 0.5), 6);
    return this.zoom !== before;
  }

  // target: centre in m; reach: how far a body and its way extend about it; ground: how far the feet do; rect: px.
  frame(target, { reach, ground, height }, rect) {
    this.target = target;
    this.cos = [Math.cos(this.yaw), Math.cos(this.pitch)];
    this.sin = [Math.sin(this.yaw), Math.sin(this.pitch)];
    const steep = this.sin[1] ** 2;
    const depth = (1 - steep) * ground + steep * reach;
    const tall = height * this.cos[1] + 2 * depth * Math.abs(this.sin[1]);
    this.distance = Math.max(5.5, 2.5 * reach);
    const near = 1 - (ground * this.cos[1]) / this.distance; // what comes nearer grows
    const pixels = this.zoom * near * Math.min(rect.height / tall, rect.width / (1.9 * reach));
    this.focus = pixels * this.distance;
    this.middle = [rect.x + rect.width / 2, rect.y + rect.height / 2];
  }

  // Writes screen x, y, depth (larger is nearer) and pixels per metre at `at`.
  project(x, y, z, out, at) {
    const [dx, dy, dz] = [x - this.target[0], y - this.target[1], z - this.target[2]];
    const across = dx * this.cos[0] - dz * this.sin[0];
    const ahead = dx * this.sin[0] + dz * this.cos[0];
    const depth = dy * this.sin[1] + ahead * this.cos[1];
    const scale = this.focus / Math.max(this.distance - depth, 0.3);
    out[at] = this.middle[0] + across * scale;
    out[at + 1] = this.middle[1] - (dy * this.cos[1] - ahead * this.sin[1]) * scale;
    out[at + 2] = depth;
    out[at + 3] = scale;
  }
}

const CIRCLE = Array.from({ length: 28 }, (_, k) => [Math.cos((k * Math.PI) / 14), Math.sin((k * Math.PI) / 14)]);

function turnsRight(o, a, b) {
  return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]) <= 0;
}

// Convex outline of points, counter-clockwise (Andrew, 1979).
function convexOutline(points) {
  points.sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const half = (list) => {
    const chain = [];
    for (const point of list) {
      while (chain.length > 1 && turnsRight(chain[chain.length - 2], chain[chain.length - 1], point)) chain.pop();
      chain.push(point);
    }
    chain.pop();
    return chain;
  };
  const lower = half(points);
  return lower.concat(half(points.reverse()));
}

// Outline of circles [x, y, radius] on the canvas.
function outlineOfCircles(circles) {
  const points = [];
  for (const [x, y, radius] of circles) {
    for (const [c, s] of CIRCLE) points.push([x + radius * c, y + radius * s]);
  }
  return convexOutline(points);
}

function addOutline(path, outline) {
  path.moveTo(outline[0][0], outline[0][1]);
  for (let k = 1; k < outline.length; k += 1) path.lineTo(outline[k][0], outline[k][1]);
  path.closePath();
}

function mix(a, b, share) {
  return [0, 1, 2].map((k) => (1 - share) * a[k] + share * b[k]);
}

function addScaled(a, b, factor) {
  return [a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]];
}

function subtract(a, b) {
  return [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
}

function lengthOf(a) {
  return Math.hypot(a[0], a[1], a[2]);
}

function unit(a, otherwise) {
  const size = lengthOf(a);
  return size > 1e-6 ? a.map((value) => value / size) : otherwise;
}

function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}
