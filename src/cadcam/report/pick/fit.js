// The camera that the picks make: Abdel-Aziz and Karara's direct linear transformation (1971), all points alike. It tells
// while one picks which pick is wrong and where the next corner is to be seen; `cadcam calibrate` estimates the camera.

const LEAST = 6; // corners that determine eleven parameters
const FLAT = 0.02; // of their spread: corners that lie no farther from a plane determine no camera

// points: [[X, Y, Z]], pixels: [[x, y]]. Returns {P (12, by rows), off: distances in px, rms} or {why}.
function fitCamera(points, pixels) {
  const n = points.length;
  if (n < LEAST) return { why: `${LEAST - n} more corner${LEAST - n > 1 ? "s" : ""} to go` };
  const T = balanced(points), U = balanced(pixels);
  const flat = eigen(scatter(points.map(T.to))).values;
  if (flat[0] < FLAT ** 2 * flat[2]) return { why: "these corners lie nearly in one plane: pick others before or behind it" };
  const rows = points.flatMap((point, k) => {
    const [X, Y, Z] = T.to(point), [x, y] = U.to(pixels[k]);
    return [
      [X, Y, Z, 1, 0, 0, 0, 0, -x * X, -x * Y, -x * Z, -x],
      [0, 0, 0, 0, X, Y, Z, 1, -y * X, -y * Y, -y * Z, -y],
    ];
  });
  const p = eigen(scatter(rows)).vectors[0];
  const project = (point) => {
    const X = [...T.to(point), 1], [a, b, c] = [0, 4, 8].map((r) => X.reduce((sum, value, k) => sum + p[r + k] * value, 0));
    return U.from([a / c, b / c]);
  };
  const depth = (point) => [...T.to(point), 1].reduce((sum, value, k) => sum + p[8 + k] * value, 0);
  const before = Math.sign(depth(points[0]));
  const off = points.map((point, k) => Math.hypot(...project(point).map((value, c) => value - pixels[k][c])));
  return {
    project: (point) => (before * depth(point) > 0 ? project(point) : null),
    eye: T.from(eyeOf(p)),
    off,
    rms: Math.hypot(...off) / Math.sqrt(n),
  };
}

// Where a camera of a matrix (12) stands.
function eyeOf(p) {
  const M = [p.slice(0, 3), p.slice(4, 7), p.slice(8, 11)], t = [-p[3], -p[7], -p[11]];
  const det = (A) => A[0][0] * (A[1][1] * A[2][2] - A[1][2] * A[2][1]) - A[0][1] * (A[1][0] * A[2][2] - A[1][2] * A[2][0])
    + A[0][2] * (A[1][0] * A[2][1] - A[1][1] * A[2][0]);
  const all = det(M);
  return [0, 1, 2].map((c) => det(M.map((row, r) => row.map((value, k) => (k === c ? t[r] : value)))) / all);
}

// A shift and scale to about 1 around 0, and back (R. Hartley, In defence of the eight-point algorithm, PAMI 1997).
function balanced(points) {
  const mean = points[0].map((_, c) => points.reduce((sum, point) => sum + point[c], 0) / points.length);
  const size = Math.sqrt(points.reduce((sum, point) => sum + point.reduce((s, v, c) => s + (v - mean[c]) ** 2, 0), 0) / points.length);
  return {
    to: (point) => point.map((value, c) => (value - mean[c]) / size),
    from: (point) => point.map((value, c) => value * size + mean[c]),
  };
}

function scatter(rows) {
  return rows[0].map((_, a) => rows[0].map((__, b) => rows.reduce((sum, row) => sum + row[a] * row[b], 0)));
}

// Eigenvalues of a symmetric matrix, least first, with vectors: Jacobi's rotations.
function eigen(A) {
  const n = A.length, a = A.map((row) => [...row]);
  const v = a.map((_, i) => a.map((__, j) => (i === j ? 1 : 0))); // rows are vectors
  for (let sweep = 0; sweep < 60; sweep++) {
    let rest = 0;
    for (let p = 0; p < n; p++) {
      for (let q = p + 1; q < n; q++) {
        rest += a[p][q] ** 2;
        if (a[p][q] === 0) continue;
        const theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
        const t = (theta < 0 ? -1 : 1) / (Math.abs(theta) + Math.hypot(theta, 1)), c = 1 / Math.hypot(t, 1), s = t * c;
        for (let k = 0; k < n; k++) [a[k][p], a[k][q]] = [c * a[k][p] - s * a[k][q], s * a[k][p] + c * a[k][q]];
        for (let k = 0; k < n; k++) [a[p][k], a[q][k]] = [c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]];
        for (let k = 0; k < n; k++) [v[p][k], v[q][k]] = [c * v[p][k] - s * v[q][k], s * v[p][k] + c * v[q][k]];
      }
    }
    if (rest < 1e-30 * a.reduce((sum, row, k) => sum + row[k] ** 2, 0)) break;
  }
  const order = a.map((_, k) => k).sort((i, j) => a[i][i] - a[j][j]);
  return { values: order.map((k) => a[k][k]), vectors: order.map((k) => v[k]) };
}
