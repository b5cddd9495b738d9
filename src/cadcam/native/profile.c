/* Steps, candidates for them and clearances along lines: see profile.h. */
#include "profile.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bodies.h"

CC_API void cc_step_sums(const cc_picture *picture, int64_t n, const double *q, const double *normal,
                         const double *below, const double *above, const double *twins, double half_length, double blur,
                         double dark, double bright, double *sums) {
    IN_USE(step_sums)(picture, n, q, normal, below, above, twins, half_length, blur, dark, bright, sums);
}

CC_API void cc_steps(int64_t n, const double *sums, const double *held, double *out) {
    IN_USE(steps)(n, sums, held, out);
}

CC_API void cc_step_residuals(const cc_picture *picture, int64_t n, const double *q, const double *normal,
                              const double *below, const double *above, const double *twins, double half_length,
                              double blur, double bright, const double *sums, int32_t bins, double width,
                              double *out) {
    IN_USE(step_residuals)(picture, n, q, normal, below, above, twins, half_length, blur, bright, sums, bins, width,
                           out);
}

CC_API void cc_candidates(const cc_picture *picture, int64_t n, const double *q, const double *normal,
                          double half_length, int32_t reach, double least, int32_t most, double *offset,
                          double *slope) {
    IN_USE(slope_extrema)(picture, n, q, normal, half_length, reach, least, most, offset, slope);
}

CC_API void cc_values_at(const cc_picture *picture, int32_t channels, int64_t n, const double *q, double *values) {
    const int64_t right = picture->width - 1, low = picture->height - 1;
    for (int64_t k = 0; k < n; k++, values += channels) {
        const double x = q[2 * k], y = q[2 * k + 1];
        const int within = x >= 0 && x <= (double)right && y >= 0 && y <= (double)low;
        const int64_t i = within ? (int64_t)x : 0, j = within ? (int64_t)y : 0;
        const float *here = picture->pixels + (j * picture->width + i) * channels;
        const float *next = here + (i < right) * channels, *below = here + (j < low) * picture->width * channels;
        const float *last = below + (next - here);
        const double u = x - (double)i, v = y - (double)j;
        for (int32_t c = 0; c < channels; c++) {
            const double upper = (1 - u) * here[c] + u * next[c], lower = (1 - u) * below[c] + u * last[c];
            values[c] = within ? (1 - v) * upper + v * lower : NAN;
        }
    }
}

/* The part of a segment in the slab |t| <= half around a sample, in its axes: d along the normal, t along the line. */
typedef struct {
    double t0, d0, t1, d1;
} piece;

/* Clip a segment to the slab; return whether any of it remains within `most` of the sample. */
static inline int clipped(double da, double ta, double db, double tb, double half, double most, piece *out) {
    if (ta > tb) {
        double s = ta;
        ta = tb, tb = s, s = da, da = db, db = s;
    }
    if (ta > half || tb < -half) return 0;
    double slope = tb > ta ? (db - da) / (tb - ta) : 0;
    out->t0 = ta < -half ? -half : ta, out->d0 = ta < -half ? da + slope * (-half - ta) : da;
    out->t1 = tb > half ? half : tb, out->d1 = tb > half ? db + slope * (half - tb) : db;
    return (out->d0 <= most || out->d1 <= most) && (out->d0 >= -most || out->d1 >= -most);
}

#define PARALLEL 0.4   /* slope up to which a line is a twin */
#define BESIDE_PX 0.4  /* segments this close to a line belong to it */
#define COVERED 0.9    /* share of the slab that a twin crosses */

/* The clearance on one side, to the nearest line and to the next beyond its twin; the nearest line as a twin, if it is
 * one: straight, about parallel, and through the whole slab. */
static void side(const piece *met, int64_t n, double sign, double half, double most, double *room, double *twin,
                 double *beyond) {
    int64_t nearest = -1;
    *room = *beyond = most, twin[0] = sign * INFINITY, twin[1] = 0;
    for (int64_t k = 0; k < n; k++) {
        double d0 = sign * met[k].d0, d1 = sign * met[k].d1, lo = d0 < d1 ? d0 : d1, hi = d0 < d1 ? d1 : d0;
        if (hi >= 0 && lo < *room) *room = lo > 0 ? lo : 0, nearest = k;
    }
    if (nearest < 0 || *room <= 0) {
        *beyond = *room;
        return;
    }
    /* the longest piece near the nearest point determines the line */
    const piece *of = met + nearest;
    for (int64_t k = 0; k < n; k++) {
        double lo = sign * met[k].d0 < sign * met[k].d1 ? sign * met[k].d0 : sign * met[k].d1;
        if (lo >= 0 && lo < *room + BESIDE_PX && met[k].t1 - met[k].t0 > of->t1 - of->t0) of = met + k;
    }
    double slope = of->t1 > of->t0 ? (of->d1 - of->d0) / (of->t1 - of->t0) : INFINITY, at = of->d0 - slope * of->t0;
    if (!(fabs(slope) < PARALLEL)) {
        *beyond = *room;
        return;
    }
    double across = 0;
    for (int64_t k = 0; k < n; k++) {
        double e0 = met[k].d0 - at - slope * met[k].t0, e1 = met[k].d1 - at - slope * met[k].t1;
        if (fabs(e0) < BESIDE_PX && fabs(e1) < BESIDE_PX) {
            across += met[k].t1 - met[k].t0;
            continue;
        }
        double d0 = sign * met[k].d0, d1 = sign * met[k].d1, lo = d0 < d1 ? d0 : d1, hi = d0 < d1 ? d1 : d0;
        if (hi >= 0 && lo < *beyond) *beyond = lo > 0 ? lo : 0;
    }
    if (across < COVERED * 2 * half) *beyond = *room;
    else twin[0] = at, twin[1] = slope;
}

enum { TOGETHER = 16 }; /* neighbouring samples, which share one search for segments */
#define TOGETHER_PX 40.0

/* The number of places, from the first of n, that lie near it. */
static int64_t together(int64_t n, const double *q) {
    int64_t k = 1;
    while (k < n && k < TOGETHER && fabs(q[2 * k] - q[0]) < TOGETHER_PX && fabs(q[2 * k + 1] - q[1]) < TOGETHER_PX) k++;
    return k;
}

/* Find which of m segments come within `reach` px of the box of n places; return their number. */
static int64_t close_to(int64_t n, const double *q, double reach, int64_t m, const double *segments, int64_t *found) {
    double left = INFINITY, right = -INFINITY, top = INFINITY, bottom = -INFINITY;
    for (int64_t i = 0; i < n; i++) {
        left = fmin(left, q[2 * i] - reach), right = fmax(right, q[2 * i] + reach);
        top = fmin(top, q[2 * i + 1] - reach), bottom = fmax(bottom, q[2 * i + 1] + reach);
    }
    int64_t count = 0;
    for (int64_t k = 0; k < m; k++) {
        const double *s = segments + 4 * k;
        if (((s[0] < left) & (s[2] < left)) | ((s[0] > right) & (s[2] > right))) continue;
        if (((s[1] < top) & (s[3] < top)) | ((s[1] > bottom) & (s[3] > bottom))) continue;
        found[count++] = k;
    }
    return count;
}

int32_t cc_clearance(int64_t n, const double *q, const double *normal, const int32_t *run, const double *arc, int64_t m,
                     const double *segments, const int32_t *segment_run, const double *segment_arc, double half_length,
                     double near, double most, double *below, double *above, double *twins, double *beyond) {
    const double reach = hypot(half_length, most) + BESIDE_PX; /* margin: rounding drops none */
    int64_t *close = malloc(((size_t)m + 1) * sizeof *close), asked = 0, end = 0;
    piece *met = malloc(((size_t)m + 1) * sizeof *met);
    const int32_t done = close && met;
    for (int64_t i = 0; i < n && done; i++) {
        if (i == end) {
            end = i + together(n - i, q + 2 * i);
            asked = close_to(end - i, q + 2 * i, reach, m, segments, close);
        }
        double x = q[2 * i], y = q[2 * i + 1], nx = normal[2 * i], ny = normal[2 * i + 1];
        int64_t count = 0;
        for (int64_t j = 0; j < asked; j++) {
            const int64_t k = close[j];
            const double *s = segments + 4 * k, *its_arc = segment_arc + 2 * k;
            double ax = s[0] - x, ay = s[1] - y, bx = s[2] - x, by = s[3] - y;
            double da = ax * nx + ay * ny, db = bx * nx + by * ny;
            if ((da > most && db > most) || (da < -most && db < -most)) continue;
            if (segment_run[k] == run[i] && its_arc[0] - near < arc[i] && arc[i] < its_arc[1] + near) continue;
            count += clipped(da, -ax * ny + ay * nx, db, -bx * ny + by * nx, half_length, most, met + count);
        }
        side(met, count, -1, half_length, most, below + i, twins + 4 * i, beyond + 2 * i);
        side(met, count, 1, half_length, most, above + i, twins + 4 * i + 2, beyond + 2 * i + 1);
    }
    free(close), free(met);
    return done;
}

/* The unit normal of a line in the picture and how it moves along that with its part; D = dq/dp in the part's frame. */
static void edge_row(const double D[2][3], const double *p, const double *t, double *normal, double *row) {
    const double x = D[0][0] * t[0] + D[0][1] * t[1] + D[0][2] * t[2];
    const double y = D[1][0] * t[0] + D[1][1] * t[1] + D[1][2] * t[2];
    double length = sqrt(x * x + y * y), v[3];
    length = length > 1e-300 ? length : 1e-300;
    normal[0] = -y / length, normal[1] = x / length;
    for (int k = 0; k < 3; k++) v[k] = normal[0] * D[0][k] + normal[1] * D[1][k];
    row[0] = v[0], row[1] = v[1], row[2] = v[2];
    row[3] = p[1] * v[2] - p[2] * v[1], row[4] = p[2] * v[0] - p[0] * v[2], row[5] = p[0] * v[1] - p[1] * v[0];
}

/* dq/dp in the part's frame: that in the camera's, times the rotation. */
static void turned(const double *J, const double *R, double D[2][3]) {
    for (int r = 0; r < 2; r++)
        for (int k = 0; k < 3; k++) D[r][k] = J[3 * r] * R[k] + J[3 * r + 1] * R[3 + k] + J[3 * r + 2] * R[6 + k];
}

void cc_edge_rows(int64_t n, const double *jacobian, const double *rotation, const double *p, const double *tangent,
                  double *normal, double *row) {
    for (int64_t i = 0; i < n; i++) {
        double D[2][3];
        turned(jacobian + 6 * i, rotation, D);
        edge_row(D, p + 3 * i, tangent + 3 * i, normal + 2 * i, row + 6 * i);
    }
}

/* The image of a point (u, v) of the plane under a lens, and its derivative, dx/du dx/dv dy/du dy/dv. */
static void through(const double *c, double *u, double *v, double *by) {
    const double x = *u, y = *v, xx = x * x, xy = x * y, yy = y * y, r2 = xx + yy, p1 = c[2], p2 = c[3];
    const double top = 1 + r2 * (c[0] + r2 * (c[1] + r2 * c[4])), top1 = c[0] + r2 * (2 * c[1] + r2 * 3 * c[4]);
    const double under = 1 + r2 * (c[5] + r2 * (c[6] + r2 * c[7])), under1 = c[5] + r2 * (2 * c[6] + r2 * 3 * c[7]);
    const double g = top / under, bend = 2 * (top1 - g * under1) / under;
    const double sx = 2 * (c[8] + 2 * c[9] * r2), sy = 2 * (c[10] + 2 * c[11] * r2); /* d(prisms)/d(u, v) over u, v */
    *u = x * g + 2 * p1 * xy + p2 * (r2 + 2 * xx) + r2 * (c[8] + c[9] * r2);
    *v = y * g + p1 * (r2 + 2 * yy) + 2 * p2 * xy + r2 * (c[10] + c[11] * r2);
    by[0] = g + xx * bend + 2 * p1 * y + 6 * p2 * x + x * sx, by[1] = xy * bend + 2 * p1 * x + 2 * p2 * y + y * sx;
    by[2] = xy * bend + 2 * p1 * x + 2 * p2 * y + x * sy, by[3] = g + yy * bend + 6 * p1 * y + 2 * p2 * x + y * sy;
}

void cc_camera_rows(int64_t n, const double *K, const double *lens, double radius, const double *rotation,
                    const double *translation, const double *p, const double *tangent, double *q, double *normal,
                    double *row) {
    const double *R = rotation, *T = translation, fx = K[0], skew = K[1], cx = K[2], fy = K[4], cy = K[5];
    for (int64_t i = 0; i < n; i++) {
        const double *at = p + 3 * i;
        const double z = R[6] * at[0] + R[7] * at[1] + R[8] * at[2] + T[2], k = z > 0 ? 1 / z : NAN;
        double u = k * (R[0] * at[0] + R[1] * at[1] + R[2] * at[2] + T[0]);
        double v = k * (R[3] * at[0] + R[4] * at[1] + R[5] * at[2] + T[1]);
        if (!(u * u + v * v < radius * radius)) u = v = NAN;
        const double u0 = u, v0 = v;
        double by[4] = {1, 0, 0, 1}, J[6], D[2][3];
        if (lens) through(lens, &u, &v, by);
        for (int j = 0; j < 2; j++) J[j] = (fx * by[j] + skew * by[2 + j]) * k, J[3 + j] = fy * by[2 + j] * k;
        J[2] = -(J[0] * u0 + J[1] * v0), J[5] = -(J[3] * u0 + J[4] * v0);
        q[2 * i] = fx * u + skew * v + cx, q[2 * i + 1] = fy * v + cy;
        turned(J, R, D);
        edge_row(D, at, tangent + 3 * i, normal + 2 * i, row + 6 * i);
    }
}

/* A sum from which a term that was added can be taken away again, whatever smaller ones it hid (A. Neumaier, Z. angew.
 * Math. Mech. 54, 1974): sum, and what rounding took from it. */
typedef struct { double sum, rest; } total;

static void add(total *t, double x) {
    const double sum = t->sum + x;
    t->rest += fabs(t->sum) >= fabs(x) ? (t->sum - sum) + x : (x - sum) + t->sum;
    t->sum = sum;
}

void cc_along_runs(int64_t n, int32_t wide, const double *values, const int32_t *run, int64_t neighbours, double *out) {
    for (int32_t c = 0; c < wide; c++) {
        int64_t from = 0, to = 0, count = 0; /* the sums, contiguous in memory */
        total all = {0, 0};
        for (int64_t i = 0; i < n; i++) {
            if (i && run[i] != run[i - 1]) from = to = i, count = 0, all = (total){0, 0};
            for (; to < n && to <= i + neighbours && run[to] == run[i]; to++)
                if (isfinite(values[to * wide + c])) add(&all, values[to * wide + c]), count++;
            for (; from < i - neighbours; from++)
                if (isfinite(values[from * wide + c])) add(&all, -values[from * wide + c]), count--;
            out[i * wide + c] = count ? (all.sum + all.rest) / (double)count : 0;
        }
    }
}

enum { UNKNOWNS = 9 };

/* x += A^-1 b for a symmetric positive A (lower half), which is overwritten. */
static void step_by(double A[UNKNOWNS][UNKNOWNS], double *b, int k, double *x) {
    for (int i = 0; i < k; i++)
        for (int j = 0; j <= i; j++) {
            for (int m = 0; m < j; m++) A[i][j] -= A[i][m] * A[j][m];
            A[i][j] = i == j ? sqrt(A[i][i] > 1e-300 ? A[i][i] : 1e-300) : A[i][j] / A[j][j];
        }
    for (int i = 0; i < k; i++) {
        for (int m = 0; m < i; m++) b[i] -= A[i][m] * b[m];
        b[i] /= A[i][i];
    }
    for (int i = k - 1; i >= 0; i--) {
        for (int m = i + 1; m < k; m++) b[i] -= A[m][i] * b[m];
        b[i] /= A[i][i], x[i] += b[i];
    }
}

void cc_pull(int64_t n, int32_t most, int32_t k, const double *rows, const double *offset, const double *strength,
             const double *stiff, const double *before, double soft, double nothing, double held, int32_t pulls,
             double *x) {
    const double sharp = -0.5 / (soft * soft);
    for (int32_t pull = 0; pull < pulls; pull++) {
        double A[UNKNOWNS][UNKNOWNS] = {{0}}, b[UNKNOWNS] = {0};
        for (int64_t i = 0; i < n; i++) {
            const double *J = rows + k * i;
            double moved = 0, all = 0, far = 0;
            for (int a = 0; a < k; a++) moved += J[a] * x[a];
            for (int32_t m = 0; m < most; m++) {
                double s = strength[most * i + m], r = offset[most * i + m] - moved;
                if (!(s > 0)) continue;
                double near = s * exp(sharp * r * r);
                all += near, far += near * r;
            }
            const double weight = all / (all + nothing), shift = far / (all + nothing);
            for (int a = 0; a < k; a++) {
                b[a] += J[a] * shift;
                for (int c = 0; c <= a; c++) A[a][c] += weight * J[a] * J[c];
            }
        }
        for (int a = 0; stiff && a < k; a++)
            for (int c = 0; c < k; c++) {
                b[a] -= stiff[a * k + c] * (before[c] + x[c]);
                if (c <= a) A[a][c] += stiff[a * k + c];
            }
        for (int a = 0; a < k; a++) A[a][a] += held * A[a][a] + 1e-300;
        step_by(A, b, k, x);
    }
}

/* Which of a sample's steps count: nearly as strong as all that are close to them; their number. */
static int strong_steps(int32_t most, const double *offset, const double *slope, double faint, double around,
                        double *at, double *sign) {
    int count = 0;
    for (int32_t m = 0; m < most; m++) {
        double strongest = 0;
        for (int32_t k = 0; k < most; k++)
            if (fabs(offset[k] - offset[m]) < around && fabs(slope[k]) > strongest) strongest = fabs(slope[k]);
        if (fabs(slope[m]) > faint * strongest) at[count] = offset[m], sign[count++] = slope[m];
    }
    return count;
}

void cc_met(int64_t n, int32_t most, const double *offset, const double *slope, int64_t lines, const int64_t *first,
            int64_t tries, const double *moved, double on, double faint, double around, double *scratch,
            double *share) {
    double *const rising = scratch, *const falling = rising + tries, *const rises = falling + tries;
    double *const falls = rises + tries; /* whether a sample meets a step, and how many of its line do */
    for (int64_t l = 0; l < lines; l++) {
        const int64_t from = first[l], to = l + 1 < lines ? first[l + 1] : n;
        memset(rising, 0, sizeof(double) * 2 * (size_t)tries);
        for (int64_t i = from; i < to; i++) {
            double at[CC_MOST_STEPS], sign[CC_MOST_STEPS];
            const int count = strong_steps(most, offset + i * most, slope + i * most, faint, around, at, sign);
            memset(rises, 0, sizeof(double) * 2 * (size_t)tries);
            for (int k = 0; k < count; k++) {
                double *const its = sign[k] > 0 ? rises : falls;
                for (int64_t t = 0; t < tries; t++) its[t] = fabs(at[k] - moved[i * tries + t]) < on ? 1 : its[t];
            }
            for (int64_t t = 0; t < 2 * tries; t++) rising[t] += rises[t];
        }
        for (int64_t t = 0; t < tries; t++)
            share[t * lines + l] = (rising[t] > falling[t] ? rising[t] : falling[t]) / (double)(to - from);
    }
}
