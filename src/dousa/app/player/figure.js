// A body out of joints: each part is the hull of a few spheres, so that its outline is right from every side.

const SEGMENT_PARTS = {
  trunk: ["chest", "waist", "hips"],
  left_upper_arm: ["lUpperArm"],
  left_forearm: ["lForearm", "lHand"],
  right_upper_arm: ["rUpperArm"],
  right_forearm: ["rForearm", "rHand"],
  left_thigh: ["lThigh"],
  left_shank: ["lShank", "lFoot"],
  right_thigh: ["rThigh"],
  right_shank: ["rShank", "rFoot"],
};

const PART_SEGMENT = {};
for (const [segment, parts] of Object.entries(SEGMENT_PARTS)) {
  for (const part of parts) PART_SEGMENT[part] = segment;
}

// Joints without which a part is not drawn.
const PART_JOINTS = {
  ...{ hips: ["lHip", "rHip"], waist: ["neck", "lHip", "rHip"], chest: ["neck", "lShoulder", "rShoulder"] },
  ...{ neck: ["neck"], head: ["neck", "head"], hair: ["neck", "head"], nose: ["neck", "head"] },
};
for (const side of ["l", "r"]) {
  const on = (...names) => names.map((name) => side + name);
  Object.assign(PART_JOINTS, {
    ...{ [`${side}UpperArm`]: on("Shoulder", "Elbow"), [`${side}Forearm`]: on("Elbow", "Wrist") },
    ...{ [`${side}Hand`]: on("Wrist", "Hand"), [`${side}Thigh`]: on("Hip", "Knee") },
    ...{ [`${side}Shank`]: on("Knee", "Ankle"), [`${side}Foot`]: on("Ankle") },
  });
}

// Spheres of all parts, m. `joints` is a flat array of 20 x 3 values, `k` the body's size against 1.7 m; parts of joints
// that are `absent` (their numbers) are left out.
function buildBody(joints, k, absent = new Set()) {
  const at = (name) => [joints[3 * JOINT[name]], joints[3 * JOINT[name] + 1], joints[3 * JOINT[name] + 2]];
  const hips = mix(at("lHip"), at("rHip"), 0.5);
  const neck = at("neck");
  const up = unit(subtract(neck, hips), [0, 1, 0]);
  const left = unit(
    addScaled(subtract(at("lShoulder"), at("rShoulder")), subtract(at("lHip"), at("rHip")), 1),
    [1, 0, 0],
  );
  const front = unit(cross(left, up), [0, 0, 1]);
  const parts = [];
  const sphere = (place, radius) => [...place, radius * k];
  const add = (name, ...spheres) => parts.push({ name, spheres });
  const frame = { k, at, hips, neck, up, left, front, sphere, add };
  buildTrunk(frame);
  buildHead(frame);
  for (const side of ["l", "r"]) {
    buildArm(frame, side);
    buildLeg(frame, side);
  }
  return absent.size ? parts.filter((part) => !PART_JOINTS[part.name].some((name) => absent.has(JOINT[name]))) : parts;
}

function buildTrunk({ k, at, hips, neck, up, left, front, sphere, add }) {
  const waist = mix(at("spine"), mix(hips, neck, 0.36), 0.5);
  const ribs = addScaled(mix(hips, neck, 0.66), front, 0.012 * k);
  const beside = (point, distance, radius) =>
    [1, -1].map((sign) => sphere(addScaled(point, left, sign * distance * k), radius));
  const inner = (name, sign) => sphere(addScaled(at(name), left, -sign * 0.04 * k), 0.054);
  const belly = mix(hips, waist, 0.6);
  add("hips", ...beside(hips, 0.074, 0.088), ...beside(mix(hips, waist, 0.5), 0.064, 0.088));
  add("waist", ...beside(belly, 0.062, 0.086), ...beside(mix(waist, ribs, 0.5), 0.066, 0.086));
  add(
    "chest",
    inner("lShoulder", 1),
    inner("rShoulder", -1),
    ...beside(ribs, 0.075, 0.1),
    ...beside(mix(waist, ribs, 0.62), 0.062, 0.086),
    ...beside(addScaled(neck, up, 0.012 * k), 0.024, 0.044),
  );
}

function buildHead({ k, at, neck, up, front, sphere, add }) {
  // Files put the head joint anywhere from the nape to the crown: only its direction is taken.
  const axis = unit(subtract(at("head"), neck), up);
  const ahead = unit(addScaled(front, axis, -(front[0] * axis[0] + front[1] * axis[1] + front[2] * axis[2])), front);
  const skull = addScaled(addScaled(neck, axis, 0.172 * k), ahead, 0.006 * k);
  const on = (height, depth, radius) => sphere(addScaled(addScaled(skull, axis, height * k), ahead, depth * k), radius);
  add("neck", sphere(addScaled(neck, axis, -0.02 * k), 0.054), sphere(addScaled(neck, axis, 0.1 * k), 0.046));
  add("head", on(0.024, 0.004, 0.084), on(-0.03, 0.026, 0.064), on(-0.072, 0.042, 0.038));
  add("hair", on(0.034, -0.022, 0.084), on(-0.03, -0.04, 0.062));
  add("nose", on(0.006, 0.082, 0.008), on(-0.022, 0.092, 0.013));
}

function buildArm({ k, at, sphere, add }, side) {
  const [shoulder, elbow, wrist, hand] = ["Shoulder", "Elbow", "Wrist", "Hand"].map((name) => at(side + name));
  add(`${side}UpperArm`, sphere(shoulder, 0.053), sphere(mix(shoulder, elbow, 0.42), 0.048), sphere(elbow, 0.038));
  add(`${side}Forearm`, sphere(elbow, 0.038), sphere(mix(elbow, wrist, 0.28), 0.041), sphere(wrist, 0.026));
  const along = unit(subtract(hand, wrist), unit(subtract(wrist, elbow), [0, -1, 0]));
  const palm = addScaled(wrist, along, Math.min(Math.max(lengthOf(subtract(hand, wrist)), 0.06 * k), 0.085 * k));
  add(`${side}Hand`, sphere(wrist, 0.026), sphere(palm, 0.036), sphere(addScaled(palm, along, 0.07 * k), 0.02));
}

function buildLeg({ k, at, front, sphere, add }, side) {
  const [hip, knee, ankle, toe] = ["Hip", "Knee", "Ankle", "Toe"].map((name) => at(side + name));
  const down = unit(subtract(ankle, knee), [0, -1, 0]);
  const ahead = unit(subtract(toe, ankle), front);
  const flat = unit(addScaled(ahead, down, -0.5 * (ahead[0] * down[0] + ahead[1] * down[1] + ahead[2] * down[2])), front);
  const calf = addScaled(mix(knee, ankle, 0.3), flat, -0.012 * k);
  add(`${side}Thigh`, sphere(hip, 0.088), sphere(mix(hip, knee, 0.36), 0.08), sphere(knee, 0.054));
  add(`${side}Shank`, sphere(knee, 0.053), sphere(calf, 0.056), sphere(ankle, 0.036));
  const ball = lengthOf(subtract(toe, ankle)) > 0.02 * k ? toe : addScaled(ankle, front, 0.14 * k);
  const wide = unit(cross(flat, down), [1, 0, 0]);
  add(
    `${side}Foot`,
    sphere(ankle, 0.036),
    sphere(addScaled(addScaled(ankle, down, 0.026 * k), flat, -0.045 * k), 0.03),
    sphere(addScaled(ball, wide, 0.022 * k), 0.028),
    sphere(addScaled(ball, wide, -0.022 * k), 0.028),
    sphere(addScaled(ball, flat, 0.045 * k), 0.024),
  );
}

// Parts on the canvas, far ones first. `wrong` holds names of segments that are drawn thicker.
function projectBody(body, offset, mirrored, camera, wrong) {
  const spot = [0, 0, 0, 0];
  const sign = mirrored ? -1 : 1;
  const drawn = body.map((part) => {
    const marked = wrong.has(PART_SEGMENT[part.name]);
    const swell = marked ? 1.22 : 1;
    let depth = 0;
    const circles = part.spheres.map(([x, y, z, radius]) => {
      camera.project(sign * (x + offset[0]), y, z + offset[1], spot, 0);
      depth += spot[2] / part.spheres.length;
      return [spot[0], spot[1], radius * swell * spot[3]];
    });
    return { name: part.name, marked, depth: depth + (DEPTH_BIAS[part.name] ?? 0), circles, outline: outlineOfCircles(circles) };
  });
  return drawn.sort((a, b) => a.depth - b.depth);
}

// What lies at about the same depth: limbs over the trunk, the chest over the waist, the head over the neck.
const DEPTH_BIAS = {
  ...{ waist: -0.1, hips: -0.08, neck: -0.06, hair: -0.05, nose: 0.02, lForearm: 0.08, rForearm: 0.08 },
  ...{ lUpperArm: 0.07, rUpperArm: 0.07, lHand: 0.09, rHand: 0.09 },
};

// Light comes from the upper left: a gradient across each part makes it round.
function shade(context, part, tones) {
  const [first, last] = [part.circles[0], part.circles.at(-1)];
  const [x, y] = [0, 1].map((k) => part.circles.reduce((sum, circle) => sum + circle[k] / part.circles.length, 0));
  let radius = Math.max(...part.circles.map((circle) => circle[2]));
  let [nx, ny] = [-(last[1] - first[1]), last[0] - first[0]];
  const size = Math.hypot(nx, ny);
  if (nx * -0.55 + ny * -0.84 < 0) [nx, ny] = [-nx, -ny];
  const weight = Math.min(size / (3 * radius), 1);
  nx = (weight * nx) / (size || 1) - (1 - weight) * 0.55;
  ny = (weight * ny) / (size || 1) - (1 - weight) * 0.84;
  if (part.name === "chest" || part.name === "hips" || part.name === "waist") {
    [nx, ny] = [-0.72, -0.5];
    radius *= 1.7;
  }
  const fill = context.createLinearGradient(x + nx * radius, y + ny * radius, x - nx * radius, y - ny * radius);
  fill.addColorStop(0, tones.light);
  fill.addColorStop(0.42, tones.base);
  fill.addColorStop(1, tones.dark);
  return fill;
}

function partPath(part) {
  const path = new Path2D();
  addOutline(path, part.outline);
  return path;
}

// The body as a solid thing; marked parts in the accent colour, hatched, with a dashed outline.
function paintSolid(context, parts, tones, accent, hatch, ratio) {
  context.lineJoin = "round";
  for (const part of parts) {
    const path = partPath(part);
    const colours = part.marked ? accent : part.name === "hair" ? tones.hair : tones;
    context.fillStyle = part.name === "nose" ? tones.dark : shade(context, part, colours);
    context.fill(path);
    if (part.marked && hatch) {
      const [a, b] = [part.circles[0], part.circles[part.circles.length - 1]];
      const angle = (Math.atan2(b[1] - a[1], b[0] - a[0]) * 180) / Math.PI;
      hatch.setTransform(new DOMMatrix().translate(a[0], a[1]).rotate(angle));
      context.fillStyle = hatch;
      context.fill(path);
    }
    context.setLineDash(part.marked && hatch ? [4.5 * ratio, 2.5 * ratio] : []);
    context.lineWidth = (part.marked ? 2 : 1) * ratio;
    context.strokeStyle = colours.line;
    if (part.name !== "nose") context.stroke(path);
  }
  context.setLineDash([]);
}

// The body as one shape: its own outline is dashed, the parts inside have none. `shown` colours marked parts.
function paintGhost(context, parts, tones, shown, ratio) {
  strokeGhost(context, parts, tones, ratio);
  for (const part of parts) {
    context.fillStyle = shade(context, part, part.marked ? shown : tones);
    context.fill(partPath(part));
  }
}

function strokeGhost(context, parts, tones, ratio) {
  context.lineJoin = "round";
  context.setLineDash([6 * ratio, 4 * ratio]);
  context.lineWidth = 3.4 * ratio;
  context.strokeStyle = tones.line;
  for (const part of parts) {
    if (part.name !== "nose" && part.name !== "hair") context.stroke(partPath(part));
  }
  context.setLineDash([]);
}

// Only the dashed outline of that shape, for laying over what hides it.
function paintGhostOutline(context, parts, tones, ratio) {
  strokeGhost(context, parts, tones, ratio);
  context.globalCompositeOperation = "destination-out";
  context.fillStyle = "#000";
  for (const part of parts) context.fill(partPath(part));
  context.globalCompositeOperation = "source-over";
}

const UNSHADOWED = new Set(["nose", "hair", "neck", "waist"]);

// Soft shadow right below: the union of the parts on the floor, again and again wider.
function paintShadow(context, body, offset, mirrored, camera, floor, colour) {
  const spot = [0, 0, 0, 0];
  const sign = mirrored ? -1 : 1;
  const flatness = Math.max(Math.abs(camera.sin[1]), 0.06);
  context.fillStyle = colour;
  for (const spread of [0.6, 1.0, 1.5, 2.1]) {
    const path = new Path2D();
    for (const part of body) {
      if (UNSHADOWED.has(part.name)) continue;
      const points = [];
      for (const [x, y, z, radius] of part.spheres) {
        camera.project(sign * (x + offset[0]), floor, z + offset[1], spot, 0);
        // What is high up casts a weak wide shadow; here it only loses size.
        const size = radius * spread * spot[3] * Math.max(1 - 0.12 * y, 0.5);
        for (const [c, s] of CIRCLE) points.push([spot[0] + size * c, spot[1] + size * flatness * s]);
      }
      addOutline(path, convexOutline(points));
    }
    context.fill(path, "nonzero");
  }
}
