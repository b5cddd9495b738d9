/* Edges of a part over direction fields: sliding and climbing, see field.h. Compiled once for each instruction set. */
#include "place.h"
#include "vectors.h"

#define TAPS 16          /* at most, to either side of a place */
#define REACH 2.5        /* blurs, to either side */
/* ---- sliding */

#define LANES 16 /* sums are added in groups of so many: a row of them is a multiple */

/* Add a plane, shifted by (x, y), to the window of sums, whose rows are `stride` long. */
static void add_shifted(const cc_field *f, int sector, int32_t x, int32_t y, int32_t wide, int32_t high, int32_t stride,
                        uint16_t *sums) {
    const uint8_t *plane = f->planes + (size_t)sector * (size_t)f->width * (size_t)f->height;
    const int32_t from_y = imax(0, -y), to_y = imin(high, f->height - y);
    if (x >= 0 && x + stride <= f->width) { /* the common case, a window inside: beyond `wide` nothing is looked at */
        const uint8_t *row = plane + (ptrdiff_t)(y + from_y) * f->width + x;
        uint16_t *out = sums + (size_t)from_y * (size_t)stride;
        for (int32_t j = from_y; j < to_y; j++, row += f->width, out += stride)
            for (int32_t k = 0; k < stride; k += LANES) *(h16 *)(out + k) += sixteen(row + k);
        return;
    }
    const int32_t from_x = imax(0, -x), to_x = imin(wide, f->width - x);
    if (from_x >= to_x) return;
    for (int32_t j = from_y; j < to_y; j++) {
        const uint8_t *row = plane + (ptrdiff_t)(y + j) * f->width + (x + from_x);
        uint16_t *restrict out = sums + (size_t)j * (size_t)stride + from_x;
        for (int32_t i = 0; i < to_x - from_x; i++) out[i] = (uint16_t)(out[i] + row[i]);
    }
}

/* The largest of the window's sums: its value, and where. */
static uint16_t largest(const uint16_t *sums, int32_t wide, int32_t high, int32_t stride, int32_t *x, int32_t *y) {
    uint16_t best = 0;
    *x = *y = 0;
    for (int32_t j = 0; j < high; j++) {
        const uint16_t *row = sums + (size_t)j * (size_t)stride;
        uint16_t top = 0;
        for (int32_t i = 0; i < wide; i++) top = row[i] > top ? row[i] : top;
        if (top <= best) continue;
        best = top, *y = j;
        for (*x = 0; row[*x] != top;) ++*x;
    }
    return best;
}

static void best_of(uint16_t *sums, int32_t wide, int32_t high, int32_t stride, int32_t keep, int32_t apart,
                    double mean, double deviation, int32_t left, int32_t top, int32_t *shift, float *score) {
    for (int32_t k = 0; k < keep; k++) {
        int32_t x, y;
        const uint16_t best = largest(sums, wide, high, stride, &x, &y);
        shift[2 * k] = left + x, shift[2 * k + 1] = top + y;
        score[k] = best ? (float)((best - mean) / deviation) : -INFINITY;
        if (k + 1 == keep) return;
        for (int32_t j = imax(0, y - apart); j <= imin(high - 1, y + apart); j++) {
            uint16_t *row = sums + (size_t)j * (size_t)stride;
            for (int32_t i = imax(0, x - apart); i <= imin(wide - 1, x + apart); i++) row[i] = 0;
        }
    }
}

void VARIANT(climb_slide)(const cc_pose_edges *v, int32_t eye, const double *poses, int32_t centre_x, int32_t centre_y,
                          int32_t reach_x, int32_t reach_y, int32_t keep, int32_t apart, uint16_t *scratch,
                          int32_t *shift, float *score) {
    const cc_eye *e = &v->eyes[eye];
    const int32_t stride = (2 * reach_x + LANES) / LANES * LANES;
    const int32_t wide = 2 * reach_x + 1, high = 2 * reach_y + 1, left = centre_x - reach_x, top = centre_y - reach_y;
    for (int64_t k = 0; k < v->n_poses; k++) {
        const rigid c = seen_by(e, poses + 12 * k);
        const cc_place *places = v->places + v->first[k * v->n_eyes + eye];
        double mean = 0, variance = 1e-9;
        memset(scratch, 0, (size_t)stride * (size_t)high * sizeof *scratch);
        for (int32_t i = 0; i < imin(v->count[k * v->n_eyes + eye], CC_SLIDABLE); i++) {
            spot s;
            if (!image_of(e, &c, &places[i], &s)) continue;
            const int sector = sector_of(s.dx, s.dy);
            add_shifted(&e->field, sector, nearest(s.x) + left, nearest(s.y) + top, wide, high, stride, scratch);
            mean += e->field.mean[sector], variance += e->field.variance[sector];
        }
        best_of(scratch, wide, high, stride, keep, apart, mean, sqrt(variance), left, top, shift + 2 * keep * k,
                score + keep * k);
    }
}

/* ---- climbing */

typedef struct { double A[6][6], b[6]; } equations;

static inline void add_row(equations *q, const double J[6], double weight, double offset) {
    for (int i = 0; i < 6; i++) {
        const double wj = weight * J[i];
        for (int j = 0; j <= i; j++) q->A[i][j] += wj * J[j];
        q->b[i] += wj * offset;
    }
}

/* The equations of the motions F x, F (6, n). */
static equations along(const equations *q, const double *F, int n) {
    equations out = {0};
    double AF[6][6] = {{0}};
    for (int i = 0; i < 6; i++)
        for (int k = 0; k < 6; k++)
            for (int j = 0; j < n; j++) AF[i][j] += (i >= k ? q->A[i][k] : q->A[k][i]) * F[k * n + j];
    for (int k = 0; k < 6; k++)
        for (int i = 0; i < n; i++) {
            for (int j = 0; j <= i; j++) out.A[i][j] += F[k * n + i] * AF[k][j];
            out.b[i] += F[k * n + i] * q->b[k];
        }
    return out;
}

/* Solve the equations, damped by (n,), into x; 0 where they are singular. */
static int solved(const equations *q, const double *damping, int n, double *x) {
    double L[6][6], y[6];
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) {
            double s = q->A[i][j];
            if (i == j) s += damping[i] + 1e-12;
            for (int k = 0; k < j; k++) s -= L[i][k] * L[j][k];
            if (i == j) {
                if (!(s > 1e-9 * (q->A[i][i] + 1e-12))) return 0;
                L[i][i] = sqrt(s);
            } else L[i][j] = s / L[j][j];
        }
        y[i] = q->b[i];
        for (int k = 0; k < i; k++) y[i] -= L[i][k] * y[k];
        y[i] /= L[i][i];
    }
    for (int i = n - 1; i >= 0; i--) {
        x[i] = y[i];
        for (int k = i + 1; k < n; k++) x[i] -= L[k][i] * x[k];
        x[i] /= L[i][i];
    }
    return 1;
}

/* pose @ exp(xi), xi = (translation, rotation), by Rodrigues' formula. With a pivot, a place of the part, that is
 * carried straight on and the part turned about it: along a screw, what nears by a share d while it turns by w slides
 * by d w / 2 of its distance, which a long lens shows as far more px than either. */
static void moved(double *pose, const double *xi, const double *pivot) {
    const double *w = xi + 3, a2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2], a = sqrt(a2);
    const double s = a > 1e-9 ? sin(a) / a : 1, c = a > 1e-9 ? (1 - cos(a)) / a2 : 0.5;
    const double d = a > 1e-4 ? (1 - s) / a2 : 1.0 / 6;
    const double W[9] = {0, -w[2], w[1], w[2], 0, -w[0], -w[1], w[0], 0};
    double W2[9], E[9], V[9], R[9], t[3];
    product(W, W, W2);
    for (int i = 0; i < 9; i++) {
        const double one = i % 4 == 0;
        E[i] = one + s * W[i] + c * W2[i], V[i] = one + c * W[i] + d * W2[i];
    }
    for (int i = 0; i < 3; i++) {
        const double *from = pivot ? E : V, *by = pivot ? pivot : xi;
        t[i] = from[3 * i] * by[0] + from[3 * i + 1] * by[1] + from[3 * i + 2] * by[2];
    }
    for (int i = 0; i < 3 && pivot; i++) {
        const int j = (i + 1) % 3, m = (i + 2) % 3;
        t[i] = pivot[i] - t[i] + xi[i] + w[j] * pivot[m] - w[m] * pivot[j];
    }
    for (int i = 0; i < 3; i++) pose[9 + i] += pose[3 * i] * t[0] + pose[3 * i + 1] * t[1] + pose[3 * i + 2] * t[2];
    product(pose, E, R);
    memcpy(pose, R, sizeof R);
}

/* A Gaussian at places 1 px apart, `taps` of them to either side; nil beyond, as far as vectors reach. */
typedef struct { double bell[2 * TAPS + 4]; int taps; } kernel;

static kernel kernel_of(double blur) {
    kernel k = {.taps = (int)lower(TAPS, ceil(REACH * blur))};
    for (int i = -k.taps; i <= k.taps; i++) k.bell[i + k.taps] = exp(-0.5 * i * i / (blur * blur));
    return k;
}

static int inside(const cc_field *f, double x, double y) {
    return x >= -0.5 && y >= -0.5 && x < f->width - 0.5 && y < f->height - 0.5;
}

/* The places along the normal (nx, ny) of a spot in a plane of the field, `n` of them. */
typedef struct {
    const uint8_t *plane;
    double x, y, nx, ny;
    int32_t width, height, n;
} walk;

static inline walk walk_of(const cc_field *f, const spot *s, const kernel *k, double nx, double ny, int sector) {
    const uint8_t *plane = f->planes + (size_t)sector * (size_t)f->width * (size_t)f->height;
    return (walk){plane, s->x - k->taps * nx, s->y - k->taps * ny, nx, ny, f->width, f->height, 2 * k->taps + 1};
}

/* The certainties at places o to o + 3 of a walk, 0 outside the picture and beyond the last place. */
INLINE d4 four_of(const walk *w, int o) {
    const d4 number = o + *(const d4 *)COUNT; /* rounded as `nearest` does */
    const i4 column = __builtin_convertvector(w->x + number * w->nx + (1048576 + 0.5), i4) - 1048576;
    const i4 row = __builtin_convertvector(w->y + number * w->ny + (1048576 + 0.5), i4) - 1048576;
    const i4 there = (column >= 0) & (column < w->width) & (row >= 0) & (row < w->height) &
                     (o + *(const i4 *)LANE < w->n);
    const i4 at = (row * w->width + column) & there;
    const i4 found = {w->plane[at[0]], w->plane[at[1]], w->plane[at[2]], w->plane[at[3]]};
    return __builtin_convertvector(found & there, d4);
}

INLINE double sum_of(d4 v) { return (v[0] + v[1]) + (v[2] + v[3]); }

/* How a spot moves in the direction (nx, ny) with the twists of its part: J (6,). */
static inline void motion_of(const cc_eye *e, const rigid *c, const spot *s, const float *p, double nx, double ny,
                             double *J) {
    const double gx = nx * e->fx * s->over_z, gy = (nx * e->skew + ny * e->fy) * s->over_z;
    const double gz = -(gx * s->u + gy * s->v);
    double g[3]; /* with the place, in the part's frame */
    for (int i = 0; i < 3; i++) g[i] = gx * c->R[i] + gy * c->R[3 + i] + gz * c->R[6 + i];
    J[0] = g[0], J[1] = g[1], J[2] = g[2];
    J[3] = p[1] * g[2] - p[2] * g[1], J[4] = p[2] * g[0] - p[0] * g[2], J[5] = p[0] * g[1] - p[1] * g[0];
}

/* Add what a place tells, across its line, and to `slid`, unless NULL, how it moves along it, which nothing tells. */
static void add_place(const cc_eye *e, const rigid *c, const cc_place *place, const kernel *k, equations *q,
                      equations *slid) {
    spot s;
    if (!image_of(e, c, place, &s) || !inside(&e->field, s.x, s.y)) return;
    const double length = sqrt(s.dx * s.dx + s.dy * s.dy);
    if (!(length > 1e-9)) return;
    const double nx = -s.dy / length, ny = s.dx / length;
    const int sector = sector_of(s.dx, s.dy);
    const double mean = e->field.mean[sector];
    const walk along = walk_of(&e->field, &s, k, nx, ny, sector);
    d4 sums = {0}, moments = {0};
    for (int o = 0; o < along.n; o += 4) {
        const d4 excess = four_of(&along, o) - mean;
        const d4 over = *(const d4 *)(k->bell + o) * (d4)((l4)excess & (excess > 0.0));
        sums += over, moments += (o - k->taps + *(const d4 *)COUNT) * over;
    }
    const double sum = sum_of(sums), moment = sum_of(moments);
    if (!(sum > 0)) return;
    double J[6];
    motion_of(e, c, &s, place->p, nx, ny, J), add_row(q, J, place->weight * sum, moment / sum);
    if (slid) motion_of(e, c, &s, place->p, -ny, nx, J), add_row(slid, J, place->weight * sum, 0);
}

/* All motions F (6, 6) of a part seen by an eye, at a place p of it: along three axes, the last one the line of sight,
 * and about them. Damped by itself each of them is free: in others a part far from its origin turns and slides at once,
 * and one far from the camera comes nearer and slides. */
static void axes_at(const rigid *c, const float *p, double *F) {
    double a[3][3], d[3], length = 0, least = INFINITY;
    for (int i = 0; i < 3; i++) d[i] = c->R[3 * i] * p[0] + c->R[3 * i + 1] * p[1] + c->R[3 * i + 2] * p[2] + c->t[i];
    for (int i = 0; i < 3; i++) {
        a[2][i] = c->R[i] * d[0] + c->R[3 + i] * d[1] + c->R[6 + i] * d[2], length += a[2][i] * a[2][i];
    }
    int side = 0;
    for (int i = 0; i < 3; i++) {
        a[2][i] /= sqrt(length) + 1e-300;
        if (fabs(a[2][i]) < least) least = fabs(a[2][i]), side = i;
    }
    for (int i = 0; i < 3; i++) a[0][i] = ((i == side) - a[2][side] * a[2][i]) / sqrt(1 - least * least);
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, m = (i + 2) % 3;
        a[1][i] = a[2][j] * a[0][m] - a[2][m] * a[0][j];
    }
    for (int of = 0; of < 3; of++)
        for (int i = 0; i < 3; i++) {
            const int j = (i + 1) % 3, m = (i + 2) % 3;
            F[6 * i + of] = F[6 * (3 + i) + 3 + of] = a[of][i], F[6 * (3 + i) + of] = 0;
            F[6 * i + 3 + of] = p[j] * a[of][m] - p[m] * a[of][j];
        }
}

static void step(const cc_pose_edges *v, int64_t k, double *pose, const kernel *kernel, const double *freedom, int n,
                 double held) {
    equations q = {0}, slid = {0};
    double x[6], xi[6] = {0}, axes[36], pivot[3], damping[6];
    int free = 0;
    for (int32_t e = 0; e < v->n_eyes; e++) {
        const rigid c = seen_by(&v->eyes[e], pose);
        const cc_place *places = v->places + v->first[k * v->n_eyes + e];
        const int32_t count = v->count[k * v->n_eyes + e];
        for (int32_t i = 0; i < count; i++) add_place(&v->eyes[e], &c, &places[i], kernel, &q, held > 0 ? &slid : NULL);
        if (n == 6 && count) {
            axes_at(&c, places[0].p, axes), freedom = axes, free = 1;
            for (int i = 0; i < 3; i++) pivot[i] = places[0].p[i];
        }
    }
    q = along(&q, freedom, n);
    if (held > 0) slid = along(&slid, freedom, n);
    for (int i = 0; i < n; i++) damping[i] = 0.01 * q.A[i][i] + held * slid.A[i][i];
    if (!solved(&q, damping, n, x)) return;
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < n; j++) xi[i] += freedom[i * n + j] * x[j];
    moved(pose, xi, free ? pivot : NULL);
}

/* The best certainty (0 to 255) under the kernel along the normal of a place, -1 outside the picture; its sector. */
static double best_at(const cc_eye *e, const rigid *c, const cc_place *place, const kernel *k, int *sector) {
    spot s;
    if (!image_of(e, c, place, &s) || !inside(&e->field, s.x, s.y)) return -1;
    const double length = sqrt(s.dx * s.dx + s.dy * s.dy) + 1e-12;
    *sector = sector_of(s.dx, s.dy);
    const walk along = walk_of(&e->field, &s, k, -s.dy / length, s.dx / length, *sector);
    double best = 0;
    for (int o = 0; o < along.n; o += 4) {
        const d4 found = *(const d4 *)(k->bell + o) * four_of(&along, o);
        best = upper(best, upper(upper(found[0], found[1]), upper(found[2], found[3])));
    }
    return best;
}

/* The certainty under all places of a pose, its mean and variance anywhere, and the weight in the picture. */
static void judge(const cc_pose_edges *v, int64_t k, int32_t eye, const double *pose, const kernel *kernel,
                  double *score) {
    const cc_eye *e = &v->eyes[eye];
    const rigid c = seen_by(e, pose);
    const cc_place *places = v->places + v->first[k * v->n_eyes + eye];
    score[0] = score[1] = score[2] = score[3] = 0;
    for (int32_t i = 0; i < v->count[k * v->n_eyes + eye]; i++) {
        int sector;
        const double best = best_at(e, &c, &places[i], kernel, &sector), w = places[i].weight;
        if (best < 0) continue;
        score[0] += w * best / 255, score[1] += w * e->field.mean[sector] / 255;
        score[2] += w * w * e->field.variance[sector] / (255.0 * 255.0), score[3] += w;
    }
}

/* The sum of ln(1 - seen + seen exp(gain)) over lines, no gain above `most`. */
static double all_lines(const double *gain, int32_t lines, const cc_belief *belief) {
    double sum = 0, product = 1; /* of which few logarithms are taken: 32 factors neither overflow nor vanish */
    for (int32_t i = 0; i < lines; i++) {
        product *= 1 - belief->seen + belief->seen * exp(lower(gain[i], belief->most));
        if (i % 32 == 31) sum += log(product), product = 1;
    }
    return sum + log(product);
}

void VARIANT(climb_evidence)(const cc_pose_edges *v, int32_t eye, const double *poses, double blur, const int32_t *line,
                             const double *share, const cc_belief *belief, double *scratch, double *out) {
    const cc_eye *e = &v->eyes[eye];
    const kernel kernel = kernel_of(blur);
    for (int64_t k = 0; k < v->n_poses; k++) {
        const rigid c = seen_by(e, poses + 12 * k);
        const int64_t first = v->first[k * v->n_eyes + eye], end = first + v->count[k * v->n_eyes + eye];
        int32_t lines = 0;
        for (int64_t i = first; i < end; i++) lines = imax(lines, line[i] + 1);
        memset(scratch, 0, (size_t)lines * sizeof *scratch);
        for (int64_t i = first; i < end; i++) {
            int sector;
            const double best = best_at(e, &c, &v->places[i], &kernel, &sector);
            if (best >= 0) scratch[line[i]] += (best / 255 - belief->even) * (belief->nats * share[k]);
        }
        out[k] = all_lines(scratch, lines, belief);
    }
}

void VARIANT(climb_poses)(const cc_pose_edges *v, double *poses, const double *freedom, int32_t n_free,
                          double held, const double *blur, int32_t steps, double *scores) {
    for (int32_t i = 0; i < steps; i++) {
        const kernel now = kernel_of(blur[i]);
        for (int64_t k = 0; k < v->n_poses; k++) step(v, k, poses + 12 * k, &now, freedom, n_free, held);
    }
    const kernel last = kernel_of(blur[steps]);
    for (int64_t k = 0; k < v->n_poses; k++)
        for (int32_t e = 0; e < v->n_eyes; e++) judge(v, k, e, poses + 12 * k, &last, scores + 4 * (k * v->n_eyes + e));
}
