// A picture on a plane in space: in cells of two triangles each, which together follow the perspective.

const CELLS = 4; // on each side
const OVER = 0.6; // px by which triangles reach over their edges, so that no seams show

/** Draw an image with its corners (left top, right top, right low, left low; in space) where project(point) puts them. */
export function drawOnPlane(context, image, corners, project) {
  const [wide, high] = [image.naturalWidth, image.naturalHeight];
  if (!wide || !high) return;
  const at = (u, v) => project([0, 1, 2].map((k) => (1 - v) * ((1 - u) * corners[0][k] + u * corners[1][k]) + v * ((1 - u) * corners[3][k] + u * corners[2][k])));
  const grid = Array.from({ length: CELLS + 1 }, (_, row) => Array.from({ length: CELLS + 1 }, (_, column) => at(column / CELLS, row / CELLS)));
  const [dx, dy] = [wide / CELLS, high / CELLS];
  for (let row = 0; row < CELLS; row += 1) {
    for (let column = 0; column < CELLS; column += 1) {
      const [a, b, c, d] = [grid[row][column], grid[row][column + 1], grid[row + 1][column + 1], grid[row + 1][column]];
      const [x, y] = [column * dx, row * dy];
      triangle(context, image, [a, b, d], [x, y, dx, dy], false);
      triangle(context, image, [c, d, b], [x + dx, y + dy, dx, dy], true);
    }
  }
}

/** corner: place of the right angle; one along the width, other along the height; source [x, y, dx, dy] of the image. */
function triangle(context, image, [corner, one, other], [x, y, dx, dy], turned) {
  const sign = turned ? -1 : 1;
  const [ax, ay] = [(sign * (one[0] - corner[0])) / dx, (sign * (one[1] - corner[1])) / dx];
  const [bx, by] = [(sign * (other[0] - corner[0])) / dy, (sign * (other[1] - corner[1])) / dy];
  const [mx, my] = [(corner[0] + one[0] + other[0]) / 3, (corner[1] + one[1] + other[1]) / 3];
  context.save();
  context.beginPath();
  for (const [px, py] of [corner, one, other]) {
    const far = Math.hypot(px - mx, py - my) || 1;
    context.lineTo(px + (OVER * (px - mx)) / far, py + (OVER * (py - my)) / far);
  }
  context.clip();
  context.transform(ax, ay, bx, by, corner[0] - ax * x - bx * y, corner[1] - ay * x - by * y);
  context.drawImage(image, 0, 0);
  context.restore();
}
