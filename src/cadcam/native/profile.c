/* Steps, candidates for them and clearances along lines: see profile.h. */
#include "profile.h"

#include <math.h>

enum { TABLE = 2048, TERMS = 5 };
#define TABLE_REACH 6.0 /* blurs: beyond, a blurred step is flat to 1e-9 */

/* Phi, phi and the blurred ramp x Phi + phi at -TABLE_REACH .. TABLE_REACH, in units of the blur. */
typedef struct {
    double step[TABLE + 2], bell[TABLE + 2];
} shapes;

static void fill(shapes *s) {
    for (int i = 0; i < TABLE + 2; i++) {
        double x = (2.0 * i / TABLE - 1.0) * TABLE_REACH;
        s->step[i] = 0.5 * erfc(-x * 0.70710678118654752440);
        s->bell[i] = 0.39894228040143267794 * exp(-0.5 * x * x);
    }
}

static const shapes *table(void) {
    static shapes made;
    static volatile int ready;
    if (!ready) fill(&made), ready = 1; /* two threads may both fill it, with the same numbers */
    return &made;
}

static inline double at(const double *values, double x) {
    double t = (x / TABLE_REACH + 1.0) * (0.5 * TABLE);
    t = t < 0 ? 0 : t > TABLE ? TABLE : t;
    int i = (int)t;
    return values[i] + (t - i) * (values[i + 1] - values[i]);
}

/* In-place inverse of the first n rows of a symmetric positive matrix (lower half given); 0 where it is none. */
static int inverse(double A[TERMS][TERMS], int n) {
    double L[TERMS][TERMS], R[TERMS][TERMS] = {{0}};
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            double s = A[i][j];
            for (int k = 0; k < j; k++) s -= L[i][k] * L[j][k];
            if (i == j) {
                if (!(s > 1e-9 * A[i][i])) return 0;
                L[i][i] = sqrt(s);
            } else L[i][j] = s / L[j][j];
        }
    for (int j = 0; j < n; j++)
        for (int i = j; i < n; i++) {
            double s = i == j ? 1.0 : 0.0;
            for (int k = j; k < i; k++) s -= L[i][k] * R[k][j];
            R[i][j] = s / L[i][i];
        }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            A[i][j] = 0;
            for (int k = i > j ? i : j; k < n; k++) A[i][j] += R[k][i] * R[k][j];
        }
    return 1;
}

typedef struct {
    double A[TERMS][TERMS], y[TERMS], yy;
    int count, clipped;
} equations;

/* Order of the terms: 1, c's step, g's bell, d, h's ramp. */
static inline void add(equations *e, const shapes *s, double d, double blur, double value) {
    double x = d / blur, f[TERMS];
    f[0] = 1.0, f[1] = at(s->step, x), f[2] = at(s->bell, x) / blur, f[3] = d;
    f[4] = d * f[1] + blur * blur * f[2];
    for (int i = 0; i < TERMS; i++) {
        for (int j = 0; j <= i; j++) e->A[i][j] += f[i] * f[j];
        e->y[i] += f[i] * value;
    }
    e->yy += value * value, e->count++;
}

/* Add the pixels of the cell; 0 where it leaves the picture. */
static int gather(const cc_picture *p, const double *q, const double *n, double below, double above, double half,
                  double blur, double dark, double bright, equations *e) {
    const shapes *s = table();
    double tx = -n[1], ty = n[0], middle = 0.5 * (above - below), reach = 0.5 * (above + below);
    double cx = q[0] + middle * n[0], cy = q[1] + middle * n[1];
    double wide = fabs(reach * n[0]) + fabs(half * tx), high = fabs(reach * n[1]) + fabs(half * ty);
    if (!(cx - wide >= 0 && cx + wide <= p->width - 1 && cy - high >= 0 && cy + high <= p->height - 1)) return 0;
    int y0 = (int)ceil(cy - high), y1 = (int)floor(cy + high);
    for (int y = y0; y <= y1; y++) {
        /* of this row, the pixels between the four sides: |u n + v t| bounds are linear in x */
        double dy = y - q[1], lo = cx - wide, hi = cx + wide;
        double side[2][3] = {{n[0], -below - n[1] * dy, above - n[1] * dy}, {tx, -half - ty * dy, half - ty * dy}};
        for (int k = 0; k < 2; k++) {
            double a = side[k][0];
            if (fabs(a) < 1e-9) {
                if (side[k][1] > 0 || side[k][2] < 0) lo = INFINITY;
                continue;
            }
            double l = side[k][a > 0 ? 1 : 2] / a + q[0], h = side[k][a > 0 ? 2 : 1] / a + q[0];
            if (l > lo) lo = l;
            if (h < hi) hi = h;
        }
        if (!(lo <= hi)) continue;
        const float *row = p->pixels + (int64_t)y * p->width;
        for (int x = (int)ceil(lo); x <= (int)floor(hi); x++) {
            add(e, s, (x - q[0]) * n[0] + dy * n[1], blur, row[x]);
            e->clipped += row[x] <= dark || row[x] >= bright;
        }
    }
    return 1;
}

static void solve(equations *e, double kink, double *out) {
    double x[TERMS], rss = e->yy;
    int n = kink < INFINITY ? TERMS : TERMS - 1;
    if (n == TERMS) e->A[4][4] += kink;
    if (e->count < TERMS + 3 || !inverse(e->A, n)) return;
    for (int i = 0; i < n; i++) {
        x[i] = 0;
        for (int j = 0; j < n; j++) x[i] += e->A[i][j] * e->y[j];
    }
    for (int i = 0; i < n; i++) rss -= x[i] * e->y[i];
    /* a term held by a prior takes no degree of freedom away: its spread is part of the model */
    int freedom = e->count - (kink == 0 ? TERMS : TERMS - 1);
    out[0] = x[1], out[1] = x[2], out[2] = n == TERMS ? x[4] : 0, out[3] = sqrt((rss > 0 ? rss : 0) / freedom);
    out[4] = e->A[1][1], out[5] = e->A[2][2], out[6] = e->A[1][2], out[7] = n == TERMS ? e->A[4][4] : 0;
    out[8] = e->count, out[9] = (double)e->clipped / e->count;
}

void cc_steps(const cc_picture *picture, int64_t n, const double *q, const double *normal, const double *below,
              const double *above, const double *kink, double half_length, double blur, double dark, double bright,
              double *out) {
    for (int64_t i = 0; i < n; i++) {
        equations e = {{{0}}, {0}, 0, 0, 0};
        double *o = out + CC_STEP_TERMS * i;
        for (int k = 0; k < CC_STEP_TERMS; k++) o[k] = NAN;
        if (gather(picture, q + 2 * i, normal + 2 * i, below[i], above[i], half_length, blur, dark, bright, &e))
            solve(&e, kink[i], o);
    }
}

static inline float bilinear(const cc_picture *p, double x, double y) {
    if (!(x >= 0 && y >= 0 && x <= p->width - 1 && y <= p->height - 1)) return NAN;
    int i = (int)x, j = (int)y;
    i -= i == p->width - 1 && i > 0, j -= j == p->height - 1 && j > 0;
    float u = (float)(x - i), v = (float)(y - j);
    const float *a = p->pixels + (int64_t)j * p->width + i, *b = a + (p->height > 1 ? p->width : 0);
    int right = p->width > 1;
    float top = a[0] + u * (a[right] - a[0]), bottom = b[0] + u * (b[right] - b[0]);
    return top + v * (bottom - top);
}

enum { LONGEST = 128, SIDE = 3 }; /* px of a profile; of the smoothing kernel on each side */

static int profile(const cc_picture *p, const double *q, const double *n, double half_length, int32_t reach,
                   float *out) {
    int along = (int)ceil(2 * half_length);
    along = along < 1 ? 1 : along;
    double pace = 2 * half_length / along;
    for (int32_t k = -reach; k <= reach; k++) {
        float sum = 0;
        for (int j = 0; j < along; j++) {
            double t = (j + 0.5) * pace - half_length;
            sum += bilinear(p, q[0] + k * n[0] - t * n[1], q[1] + k * n[1] + t * n[0]);
        }
        out[k + reach] = sum / (float)along;
    }
    return 2 * reach + 1;
}

/* Put an extremum in its place among the strongest. */
static void insert(double at, double slope, int32_t most, double *offset, double *slopes) {
    for (int32_t i = 0; i < most; i++)
        if (isnan(slopes[i]) || fabs(slopes[i]) < fabs(slope)) {
            double o = offset[i], s = slopes[i];
            offset[i] = at, slopes[i] = slope, at = o, slope = s;
            if (isnan(slope)) return;
        }
}

void cc_candidates(const cc_picture *picture, int64_t n, const double *q, const double *normal, double half_length,
                   int32_t reach, double least, int32_t most, double *offset, double *slope) {
    float values[LONGEST];
    double kernel[SIDE + 1], r[LONGEST];
    for (int k = 0; k <= SIDE; k++) kernel[k] = k * 0.39894228040143267794 * exp(-0.5 * k * k);
    int32_t within = reach > LONGEST / 2 - SIDE - 2 ? LONGEST / 2 - SIDE - 2 : reach;
    for (int64_t i = 0; i < n; i++) {
        double *o = offset + i * most, *s = slope + i * most;
        for (int32_t k = 0; k < most; k++) o[k] = s[k] = NAN;
        int count = profile(picture, q + 2 * i, normal + 2 * i, half_length, within + SIDE + 1, values);
        for (int k = SIDE; k < count - SIDE; k++) {
            r[k] = 0;
            for (int j = 1; j <= SIDE; j++) r[k] += kernel[j] * (values[k + j] - values[k - j]);
        }
        for (int k = SIDE + 1; k < count - SIDE - 1; k++) {
            double here = fabs(r[k]), sign = r[k] < 0 ? -1 : 1, before = sign * r[k - 1], after = sign * r[k + 1];
            if (!(here >= least && here > before && here >= after)) continue;
            double bend = before + after - 2 * here, shift = bend < 0 ? 0.5 * (before - after) / bend : 0;
            insert(k - (within + SIDE + 1) + shift, r[k], most, o, s);
        }
    }
}

/* Shorten below/above to where segment a-b, in the sample's axes (d along the normal, t along the line), crosses the
 * slab |t| <= half. */
static inline void shorten(double da, double ta, double db, double tb, double half, double *below, double *above) {
    if (ta > tb) {
        double s = ta;
        ta = tb, tb = s, s = da, da = db, db = s;
    }
    if (ta > half || tb < -half) return;
    double slope = tb > ta ? (db - da) / (tb - ta) : 0;
    double d0 = ta < -half ? da + slope * (-half - ta) : da, d1 = tb > half ? db + slope * (half - tb) : db;
    double lo = d0 < d1 ? d0 : d1, hi = d0 < d1 ? d1 : d0;
    if (hi >= 0 && lo < *above) *above = lo > 0 ? lo : 0;
    if (lo <= 0 && -hi < *below) *below = hi < 0 ? -hi : 0;
}

void cc_clearance(int64_t n, const double *q, const double *normal, const int32_t *run, const double *arc, int64_t m,
                  const double *segments, const int32_t *segment_run, const double *segment_arc, double half_length,
                  double near, double most, double *below, double *above) {
    for (int64_t i = 0; i < n; i++) {
        double x = q[2 * i], y = q[2 * i + 1], nx = normal[2 * i], ny = normal[2 * i + 1];
        below[i] = above[i] = most;
        for (int64_t k = 0; k < m; k++) {
            const double *s = segments + 4 * k;
            if (segment_run[k] == run[i] && segment_arc[2 * k] - near < arc[i] && arc[i] < segment_arc[2 * k + 1] + near)
                continue;
            double ax = s[0] - x, ay = s[1] - y, bx = s[2] - x, by = s[3] - y;
            double da = ax * nx + ay * ny, db = bx * nx + by * ny;
            if ((da > most && db > most) || (da < -most && db < -most)) continue;
            shorten(da, -ax * ny + ay * nx, db, -bx * ny + by * nx, half_length, below + i, above + i);
        }
    }
}
