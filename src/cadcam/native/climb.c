/* Edges of a part that climb direction fields, and their evidence: see field.h. Compiled once for each instruction
 * set. */
#include "eights.h"

#define REACH 2.5 /* blurs, to either side */

typedef struct { double A[6][6], b[6]; } equations;

/* The same while it is added up: the lower half of A, and b, of eight places at a time. */
typedef struct { f8 A[21], b[6]; } sums;

INLINE void add_rows(sums *q, const f8 J[6], f8 weight, f8 offset) {
    for (int i = 0, m = 0; i < 6; i++) {
        const f8 wj = weight * J[i];
        for (int j = 0; j <= i; j++, m++) q->A[m] += wj * J[j];
        q->b[i] += wj * offset;
    }
}

INLINE double sum_of(f8 v) {
    return (((double)v[0] + v[1]) + ((double)v[2] + v[3])) + (((double)v[4] + v[5]) + ((double)v[6] + v[7]));
}

static equations summed(const sums *q) {
    equations out = {0};
    for (int i = 0, m = 0; i < 6; i++) {
        for (int j = 0; j <= i; j++, m++) out.A[i][j] = sum_of(q->A[m]);
        out.b[i] = sum_of(q->b[i]);
    }
    return out;
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
        if (!isfinite(x[i])) return 0;
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

/* A Gaussian at places 1 px apart, `taps` of them to either side. */
typedef struct { float bell[2 * TAPS + 1]; int taps; } kernel;

static kernel kernel_of(double blur) {
    kernel k = {.taps = (int)lower(TAPS, ceil(REACH * blur))};
    for (int i = -k.taps; i <= k.taps; i++) k.bell[i + k.taps] = (float)exp(-0.5 * i * i / (blur * blur));
    return k;
}

/* How spots move in directions (nx, ny) with the twists about the pivot: J (6,). */
INLINE void motions_of(const view *w, const eight_places *e, const eight_spots *s, f8 nx, f8 ny, f8 *J) {
    const f8 gx = nx * w->fx * s->over_z, gy = (nx * w->skew + ny * w->fy) * s->over_z;
    const f8 gz = -(gx * s->u + gy * s->v), *p = e->p;
    for (int i = 0; i < 3; i++) J[i] = gx * w->R[i] + gy * w->R[3 + i] + gz * w->R[6 + i];
    J[3] = p[1] * J[2] - p[2] * J[1], J[4] = p[2] * J[0] - p[0] * J[2], J[5] = p[0] * J[1] - p[1] * J[0];
}

/* Add what places tell, across their lines, and to `slid`, unless NULL, how they move along them, which nothing
 * tells. */
static void add_places(const view *w, const eight_places *e, const kernel *k, sums *q, sums *slid) {
    const eight_spots s = images_of(w, e, 0);
    const eight_planes planes = planes_of(w->field, &s);
    const f8 mean = looked_up(w->field->mean, s.sector);
    f8 all = eight(0), moments = eight(0), J[6];
    for (int o = -k->taps; o <= k->taps; o++) {
        const f8 excess = certainties(w->field, &planes, &s, o) - mean;
        const f8 over = k->bell[o + k->taps] * only(excess > 0.0f, excess);
        all += over, moments += (float)o * over;
    }
    const i8 told = s.there & (all > 0.0f) & (s.length > 1e-9f);
    const f8 weight = only(told, e->weight * all);
    motions_of(w, e, &s, s.nx, s.ny, J), add_rows(q, J, weight, moments / choose(told, all, eight(1)));
    if (slid) motions_of(w, e, &s, -s.ny, s.nx, J), add_rows(slid, J, weight, eight(0));
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

/* The motions of `freedom` (6, n), whose twists are about the part's origin, as twists about a pivot. */
static void about(const float *pivot, const double *freedom, int n, double *F) {
    for (int of = 0; of < n; of++)
        for (int i = 0; i < 3; i++) {
            const int j = (i + 1) % 3, m = (i + 2) % 3;
            const double *w = freedom + 3 * n + of;
            F[i * n + of] = freedom[i * n + of] + (w[j * n] * pivot[m] - w[m * n] * pivot[j]);
            F[(3 + i) * n + of] = w[i * n];
        }
}

static void step(const cc_pose_edges *v, int64_t k, double *pose, const kernel *kernel, const double *freedom, int n,
                 double held) {
    sums told = {0}, along_lines = {0};
    double x[6], xi[6] = {0}, axes[36], F[36], pivot[3], damping[6];
    const cc_place *at = NULL; /* the pivot: the first place in the last eye that sees one */
    for (int32_t e = 0; e < v->n_eyes; e++) {
        const run r = run_of(v, k, e);
        if (!r.count) continue;
        at = r.places;
        if (n == 6) {
            const rigid c = seen_by(&v->eyes[e], pose);
            axes_at(&c, at->p, axes), freedom = axes;
        }
    }
    if (!at) return;
    for (int32_t e = 0; e < v->n_eyes; e++) {
        const run r = run_of(v, k, e);
        const view w = view_of(&v->eyes[e], pose, at->p);
        for (int32_t i = 0; i < r.count; i += 8) {
            const eight_places some = eight_of(r.places + i, r.count - i, at->p);
            add_places(&w, &some, kernel, &told, held > 0 ? &along_lines : NULL);
        }
    }
    about(at->p, freedom, n, F);
    const equations all = summed(&told), slid = summed(&along_lines), q = along(&all, F, n), by = along(&slid, F, n);
    for (int i = 0; i < n; i++) damping[i] = 0.01 * q.A[i][i] + held * by.A[i][i];
    if (!solved(&q, damping, n, x)) return;
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < n; j++) xi[i] += freedom[i * n + j] * x[j];
    for (int i = 0; i < 3; i++) pivot[i] = at->p[i];
    moved(pose, xi, n == 6 ? pivot : NULL);
}

/* The best certainties (0 to 255) under the kernel along the normals of spots. */
INLINE f8 best_at(const cc_field *f, const eight_spots *s, const kernel *k) {
    const eight_planes planes = planes_of(f, s);
    f8 best = eight(0);
    for (int o = -k->taps; o <= k->taps; o++)
        best = most_of(best, k->bell[o + k->taps] * certainties(f, &planes, s, o));
    return best;
}

/* The certainty under all places of a pose, its mean and variance anywhere, and the weight in the picture. */
static void judge(const cc_pose_edges *v, int64_t k, int32_t eye, const double *pose, const kernel *kernel,
                  double *score) {
    const cc_field *f = &v->eyes[eye].field;
    const run r = run_of(v, k, eye);
    score[0] = score[1] = score[2] = score[3] = 0;
    if (!r.count) return;
    const view w = view_of(&v->eyes[eye], pose, r.places->p);
    for (int32_t i = 0; i < r.count; i += 8) {
        const eight_places some = eight_of(r.places + i, r.count - i, r.places->p);
        const eight_spots s = images_of(&w, &some, 0);
        const f8 best = best_at(f, &s, kernel);
        for (int m = 0; m < 8; m++) {
            const double weight = s.there[m] ? some.weight[m] : 0;
            score[0] += weight * best[m] / 255, score[1] += weight * f->mean[s.sector[m]] / 255;
            score[2] += weight * weight * f->variance[s.sector[m]] / (255.0 * 255.0), score[3] += weight;
        }
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

/* Add what the places of a run say to that of their lines. */
static void add_gains(const cc_eye *e, const double *pose, const run *r, const int32_t *line, const kernel *kernel,
                      const cc_belief *belief, double nats, double *gain) {
    if (!r->count) return;
    const view w = view_of(e, pose, r->places->p);
    for (int32_t i = 0; i < r->count; i += 8) {
        const eight_places some = eight_of(r->places + i, r->count - i, r->places->p);
        const eight_spots s = images_of(&w, &some, 0);
        const f8 best = best_at(&e->field, &s, kernel);
        for (int m = 0; m < 8; m++)
            if (s.there[m]) gain[line[i + m]] += ((double)best[m] / 255 - belief->even) * nats;
    }
}

void VARIANT(climb_evidence)(const cc_pose_edges *v, int32_t eye, const double *poses, double blur, const int32_t *line,
                             const double *share, const cc_belief *belief, double *scratch, double *out) {
    const kernel kernel = kernel_of(blur);
    for (int64_t k = 0; k < v->n_poses; k++) {
        const run r = run_of(v, k, eye);
        const int32_t *its = line + (r.places - v->places);
        int32_t lines = 0;
        for (int32_t i = 0; i < r.count; i++) lines = imax(lines, its[i] + 1);
        memset(scratch, 0, (size_t)lines * sizeof *scratch);
        add_gains(&v->eyes[eye], poses + 12 * k, &r, its, &kernel, belief, belief->nats * share[k], scratch);
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
