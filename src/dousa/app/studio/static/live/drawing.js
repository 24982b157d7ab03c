// The skeleton over the picture of the camera.

const SURE = 0.5;
const LIMB = { left: "#4ab8ff", right: "#ffa24a", middle: "#35e0a8" };
const FIRST_OF_BODY = 11; // before it the face, whose points are odd at the left; behind it odd numbers are left too

const sideOf = (one, other) => (one % 2 === other % 2 ? (one % 2 ? "left" : "right") : "middle");

/** Draw a person {points: [[x, y] shares], visibility}, or nobody (null). */
export function drawPerson(canvas, person, bones) {
  const context = canvas.getContext("2d");
  context.clearRect(0, 0, canvas.width, canvas.height);
  if (!person) return;
  const place = person.points.map(([x, y]) => [x * canvas.width, y * canvas.height]);
  const unit = Math.max(canvas.width, canvas.height) / 640;
  context.lineCap = "round";
  for (const pass of ["#0009", null]) {
    for (const [one, other] of bones) {
      const sure = Math.min(person.visibility[one], person.visibility[other]);
      if (sure < 0.15) continue;
      Object.assign(context, { strokeStyle: pass ?? LIMB[sideOf(one, other)], lineWidth: (pass ? 7 : 4) * unit, globalAlpha: sure < SURE ? 0.4 : 1 });
      context.beginPath();
      context.moveTo(...place[one]);
      context.lineTo(...place[other]);
      context.stroke();
    }
  }
  context.globalAlpha = 1;
  context.fillStyle = "#ffffff";
  for (let number = FIRST_OF_BODY; number < place.length; number += 1) {
    if (person.visibility[number] < SURE) continue;
    context.beginPath();
    context.arc(...place[number], 2.6 * unit, 0, 2 * Math.PI);
    context.fill();
  }
}
