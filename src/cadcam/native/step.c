/* Steps fitted to the pixels of cells along lines, and their residuals: cc_step_sums, cc_steps and
 * cc_step_residuals of profile.h, compiled once for each instruction set. */
#include "hot.h"
#include "profile.h"
#include "vectors.h"

enum { OWN = 5, TERMS = OWN + 2, CHUNK = 256, SUMS = TERMS * (TERMS + 1) / 2 + TERMS + 1 };
enum { COUNTED = SUMS, CLIPPED, OF_TERMS }; /* what follows the sums in the caller's memory */
_Static_assert(OF_TERMS + 1 == CC_STEP_SUMS && COUNTED == CC_STEP_ALL, "profile.h says where they are");
#define TWIN 1e-4 /* variance of a pixel over that of a twin's contrast: a weak prior, for twins that are not visible */
#define HELD 1e12  /* practically infinite */
#define SPREAD 3.0 /* blurs beyond which a step is level */
#define NEARLY 0.01 /* white's share that the mean of a row may fall short of white, if with rows beyond it does not */
#define LEFT_OUT 1e6 /* brightness that no pixel has */
#define MAGIC 6755399441055744.0 /* 1.5 * 2^52: adding a number rounds it to an integer in the low bits */

/* Pixels of a cell: distance from the line, position along it, brightness less that of the first. Rows are written as
 * vectors: there is room for the rest of one. */
typedef struct {
    double d[CHUNK + 4], t[CHUNK + 4], value[CHUNK + 4];
    int n;
} pixels;

/* Which rows of a cell, 1 px deep along its line, are white, and what their pixels add up to. Noise makes some pixels
 * of a bright side white. Without them it would seem darker than it is, and the step to lie elsewhere: so whole rows
 * are white, by their means. Next to them, where brightness rises, single pixels are. */
enum { ROWS = 128, BEYOND = 3, NOT_WHITE = 0, SOME_WHITE, ALL_WHITE };
typedef struct {
    double bright, sum[ROWS];
    int32_t number[ROWS];
    char white[ROWS];
    int told;
} rows;

/* Another line of the model in the cell: it steps where d = at + slope t; side: the one it lies on, -1 or 1. */
typedef struct {
    double at, slope, side;
} twin;

/* The residuals of a cell's steps by distance from the line: their sums and numbers of pixels in bins of a width, the
 * first starting at `from`. x: the terms' factors. */
typedef struct {
    double x[TERMS], from, width, *sum, *number;
    int32_t count;
} residuals;

typedef struct {
    d4 sum[SUMS];
    double first, dark, bright;
    twin twins[2];
    l4 clipped;
    int count, terms;
    rows *rows;            /* if white is told by rows: first which ones are, then their pixels are left out */
    const residuals *left; /* if the residuals are requested, not the sums */
} equations;

static int row_of(double d) {
    const int at = ROWS / 2 + (int)floor(d + 0.5);
    return at < 0 ? 0 : at < ROWS ? at : ROWS - 1;
}

static void add_to_rows(rows *of, const pixels *p, double first) {
    for (int k = 0; k < p->n; k++) {
        const int at = row_of(p->d[k]);
        of->sum[at] += p->value[k] + first, of->number[at]++;
    }
}

/* A row is white if it and the next ones to one side are, in the mean, and it hardly less; the rows beside it are in
 * part. */
static void tell_white(rows *of) {
    for (int k = 0; k < ROWS; k++) {
        of->white[k] = NOT_WHITE;
        if (!of->number[k] || of->sum[k] < (of->bright - NEARLY) * of->number[k]) continue;
        for (int side = -1; side <= 1; side += 2) {
            double sum = 0;
            int number = 0;
            for (int j = k, m = 0; m < BEYOND && j >= 0 && j < ROWS; j += side, m++)
                sum += of->sum[j], number += of->number[j];
            if (sum >= of->bright * number) of->white[k] = ALL_WHITE;
        }
    }
    for (int k = 1; k < ROWS - 1; k++)
        if (of->white[k] == NOT_WHITE && (of->white[k - 1] == ALL_WHITE || of->white[k + 1] == ALL_WHITE))
            of->white[k] = SOME_WHITE;
    of->told = 1;
}

static void leave_out_white(const rows *of, pixels *p, double first) {
    for (int k = 0; k < p->n; k++) {
        const char white = of->white[row_of(p->d[k])];
        if (white == ALL_WHITE || (white == SOME_WHITE && !(p->value[k] + first < of->bright))) p->value[k] = LEFT_OUT;
    }
}

/* exp(-y) for y >= 0, with a relative error below 1e-8: 2^k times a polynomial on [-1/2, 1/2]. */
INLINE d4 decay(d4 y) {
    const d4 most = {700, 700, 700, 700}, zero = {0, 0, 0, 0};
    l4 far = y > most;
    y = (d4)(((l4)most & far) | ((l4)y & ~far));
    d4 t = y * -1.4426950408889634 + zero, whole = t + MAGIC;
    d4 f = (t - (whole - MAGIC)) * 0.69314718055994531;
    static const double by[] = {1 / 720.0, 1 / 120.0, 1 / 24.0, 1 / 6.0, 0.5, 1, 1};
    d4 p = four_d(1 / 5040.0);
    for (int k = 0; k < 7; k++) p = fused_d(f, p, four_d(by[k]));
    l4 power = ((l4)whole + 1023) << 52;
    return p * (d4)power;
}

/* The normal distribution's bell and, by 26.2.17 of Abramowitz and Stegun (error below 8e-8), its integral. */
INLINE void bell_and_step(d4 x, d4 *bell, d4 *step) {
    const d4 zero = {0, 0, 0, 0};
    l4 negative = x < zero;
    d4 size = (d4)((l4)x & 0x7FFFFFFFFFFFFFFF);
    d4 phi = 0.39894228040143268 * decay(0.5 * x * x);
    static const double by[] = {-1.821255978, 1.781477937, -0.356563782, 0.319381530};
    d4 t = 1.0 / (1.0 + 0.2316419 * size), p = four_d(1.330274429);
    for (int k = 0; k < 4; k++) p = fused_d(t, p, four_d(by[k]));
    d4 tail = phi * t * p;
    d4 other = 1.0 - tail;
    *bell = phi, *step = (d4)(((l4)tail & negative) | ((l4)other & ~negative));
}

/* Terms: 1, c's step, g's bell, the ramps below and above, the steps of the twins: `terms` of them. */
INLINE void add_terms(equations *e, pixels *p, double blur, const twin *twins, const int terms) {
    const double sharp = 1 / blur;
    const int sums = terms * (terms + 1) / 2 + terms + 1;
    const double dark = e->dark - e->first, bright = e->bright - e->first;
    d4 sum[SUMS];
    for (int s = 0; s < sums; s++) sum[s] = e->sum[s];
    for (int k = 0; k < 4; k++) p->d[p->n + k] = p->t[p->n + k] = p->value[p->n + k] = 0;
    for (int k = 0; k < p->n; k += 4) {
        d4 f[TERMS], d = *(const d4 *)(p->d + k), value = *(const d4 *)(p->value + k), step, bell;
        bell_and_step(d * sharp, &bell, &step);
        const l4 there = *(const d4 *)COUNT < (double)(p->n - k); /* the last vector may be padded */
        const l4 seen = there & (value < bright);
        f[0] = (d4)((l4)(d4){1, 1, 1, 1} & seen), value *= f[0], d *= f[0];
        f[1] = step * f[0], f[2] = bell * sharp * f[0], f[4] = d * step + blur * bell * f[0], f[3] = d - f[4];
        for (int i = OWN; i < terms; i++) {
            const twin *w = &twins[i - OWN];
            bell_and_step((d - w->at - w->slope * *(const d4 *)(p->t + k)) * (sharp * w->side), &bell, &step);
            f[i] = step * f[0];
        }
        int s = 0;
        for (int i = 0; i < terms; i++)
            for (int j = 0; j <= i; j++) sum[s] = fused_d(f[i], f[j], sum[s]), s++;
        for (int i = 0; i < terms; i++) sum[s] = fused_d(f[i], value, sum[s]), s++;
        sum[s] = fused_d(value, value, sum[s]);
        e->clipped -= (value <= dark) & seen;
    }
    for (int s = 0; s < sums; s++) e->sum[s] = sum[s];
    e->count += p->n, p->n = 0;
}

/* Add the pixels' residuals to their bins. */
static void add_left(equations *e, pixels *p, double blur) {
    const residuals *left = e->left;
    const double sharp = 1 / blur, *x = left->x;
    for (int k = 0; k < 4; k++) p->d[p->n + k] = p->t[p->n + k] = p->value[p->n + k] = 0;
    for (int k = 0; k < p->n; k += 4) {
        d4 d = *(const d4 *)(p->d + k), step, bell;
        bell_and_step(d * sharp, &bell, &step);
        const d4 ramp = d * step + blur * bell;
        d4 rest = *(const d4 *)(p->value + k) - x[0] - x[1] * step - x[2] * sharp * bell;
        rest -= x[3] * (d - ramp) + x[4] * ramp;
        for (int i = OWN; i < e->terms; i++) {
            const twin *w = &e->twins[i - OWN];
            bell_and_step((d - w->at - w->slope * *(const d4 *)(p->t + k)) * (sharp * w->side), &bell, &step);
            rest -= x[i] * step;
        }
        for (int m = 0; m < 4 && k + m < p->n; m++) {
            if (!(p->value[k + m] < e->bright - e->first)) continue; /* white: brighter, but not by how much */
            const int bin = (int)floor((d[m] - left->from) / left->width);
            if (bin >= 0 && bin < left->count) left->sum[bin] += rest[m], left->number[bin]++;
        }
    }
    p->n = 0;
}

static void add(equations *e, pixels *p, double blur) {
    if (e->rows && !e->rows->told) {
        add_to_rows(e->rows, p, e->first), p->n = 0;
        return;
    }
    if (e->rows) leave_out_white(e->rows, p, e->first);
    if (e->left) add_left(e, p, blur);
    else if (e->terms == OWN) add_terms(e, p, blur, e->twins, OWN);
    else if (e->terms == OWN + 1) add_terms(e, p, blur, e->twins, OWN + 1);
    else add_terms(e, p, blur, e->twins, OWN + 2);
}

/* Four numbers of a picture that ends at `end`. */
INLINE d4 four(const float *at, const float *end) {
    if (end - at >= 4) return __builtin_convertvector(*(const f4 *)at, d4);
    d4 v = {at[0], 0, 0, 0};
    for (int k = 1; at + k < end; k++) v[k] = at[k];
    return v;
}

/* Add a row's pixels, `count` of them, the first at distance d, each `across` farther. */
static void add_row(equations *e, pixels *some, const float *row, const float *end, int count, double d, double across,
                    double t, double along, double blur) {
    while (count > 0) {
        if (some->n == CHUNK) add(e, some, blur);
        const int n = imin(count, CHUNK - some->n);
        for (int k = 0; k < n; k += 4) {
            const d4 further = k + *(const d4 *)COUNT;
            *(d4 *)(some->d + some->n + k) = d + further * across, *(d4 *)(some->t + some->n + k) = t + further * along;
            *(d4 *)(some->value + some->n + k) = four(row + k, end) - e->first;
        }
        some->n += n, row += n, count -= n, d += n * across, t += n * along;
    }
}

/* Two opposite sides of a cell: in a row dy below the sample the interval from lo + lean dy to hi + lean dy to its
 * right; or, if the sides are horizontal, the whole row where lean dy is between lo and hi. */
typedef struct {
    double lo, hi, lean;
    int level;
} sides;

/* Those with least <= a dx + b dy <= most. */
static sides sides_of(double a, double b, double least, double most) {
    if (fabs(a) < 1e-9) return (sides){least, most, b, 1};
    const double over = 1 / a;
    return (sides){(a > 0 ? least : most) * over, (a > 0 ? most : least) * over, -b * over, 0};
}

INLINE void cut(const sides *s, double dy, double *lo, double *hi) {
    const double at = s->lean * dy;
    if (!s->level) *lo = upper(*lo, s->lo + at), *hi = lower(*hi, s->hi + at);
    else if (at < s->lo || at > s->hi) *lo = INFINITY;
}

/* Add the pixels of the cell; 0 where it leaves the picture. */
static int gather(const cc_picture *p, const double *q, const double *n, double below, double above, double half,
                  double blur, equations *e) {
    pixels some;
    some.n = 0;
    double tx = -n[1], ty = n[0], middle = 0.5 * (above - below), reach = 0.5 * (above + below);
    double cx = q[0] + middle * n[0], cy = q[1] + middle * n[1];
    double wide = fabs(reach * n[0]) + fabs(half * tx), high = fabs(reach * n[1]) + fabs(half * ty);
    if (!(cx - wide >= 0 && cx + wide <= p->width - 1 && cy - high >= 0 && cy + high <= p->height - 1)) return 0;
    e->first = p->pixels[(int64_t)cy * p->width + (int64_t)cx];
    const sides across = sides_of(n[0], n[1], -below, above), along = sides_of(tx, ty, -half, half);
    for (int y = (int)ceil(cy - high); y <= (int)floor(cy + high); y++) {
        double dy = y - q[1], lo = cx - wide - q[0], hi = cx + wide - q[0];
        cut(&across, dy, &lo, &hi), cut(&along, dy, &lo, &hi);
        if (!(lo <= hi)) continue;
        const int x0 = (int)ceil(q[0] + lo), count = (int)floor(q[0] + hi) - x0 + 1;
        const double dx = x0 - q[0];
        add_row(e, &some, p->pixels + (int64_t)y * p->width + x0, p->pixels + (int64_t)p->height * p->width, count,
                dx * n[0] + dy * n[1], n[0], dx * tx + dy * ty, tx, blur);
    }
    add(e, &some, blur);
    return 1;
}

/* Add the pixels of the cell that are not in white rows; 0 where it leaves the picture. */
static int gather_by_rows(const cc_picture *p, const double *q, const double *n, double below, double above,
                          double half, double blur, double bright, equations *e) {
    rows of = {.bright = bright};
    e->rows = &of, e->bright = 0.5 * LEFT_OUT;
    if (!gather(p, q, n, below, above, half, blur, e)) return 0;
    tell_white(&of);
    const int inside = gather(p, q, n, below, above, half, blur, e);
    e->rows = NULL;
    return inside;
}

INLINE d4 either(l4 mask, d4 yes, d4 no) { return (d4)(((l4)yes & mask) | ((l4)no & ~mask)); }

/* What the sums of four cells with as many terms say: the terms' factors x, the share of the squares that they explain,
 * and cofactors of the step and its bell; there: a mask of the cells whose pixels determine them. */
typedef struct {
    d4 x[TERMS], explained, Q[2];
    l4 there;
} factors;

/* x of A x = y for the first n rows of symmetric positive A (lower half, overwritten by its factor), y' A^-1 y, and
 * numbers 1 and 2 of the inverse's diagonal; of those of f->there, which leaves out the A that are not positive. */
INLINE void solved(d4 A[TERMS][TERMS], const d4 *y, const int n, factors *f) {
    const d4 one = four_d(1);
    d4 over[TERMS], z[TERMS];
    f->explained = four_d(0);
    for (int i = 0; i < n; i++) {
        d4 right = y[i], s = A[i][i];
        for (int j = 0; j < i; j++) {
            for (int k = 0; k < j; k++) A[i][j] -= A[i][k] * A[j][k];
            A[i][j] *= over[j], right -= A[i][j] * z[j];
        }
        for (int k = 0; k < i; k++) s -= A[i][k] * A[i][k];
        f->there &= s > 1e-9 * A[i][i];
        over[i] = 1 / root_d(either(f->there, s, one)), z[i] = right * over[i], f->explained += z[i] * z[i];
    }
    for (int i = n - 1; i >= 0; i--) {
        d4 s = z[i];
        for (int k = i + 1; k < n; k++) s -= A[k][i] * f->x[k];
        f->x[i] = s * over[i];
    }
    for (int of = 1; of <= 2; of++) {
        d4 column[TERMS], sum = four_d(0);
        for (int i = of; i < n; i++) {
            d4 s = four_d(i == of);
            for (int k = of; k < i; k++) s -= A[i][k] * column[k];
            column[i] = s * over[i], sum += column[i] * column[i];
        }
        f->Q[of - 1] = sum;
    }
}

/* Four numbers, each `at` doubles after one of the given places. */
INLINE d4 column_of(const double *const of[4], int at) { return (d4){of[0][at], of[1][at], of[2][at], of[3][at]}; }

INLINE factors factors_of(const double *const sum[4], const int terms, const double *const held[4]) {
    d4 A[TERMS][TERMS], y[TERMS];
    int s = 0;
    for (int i = 0; i < terms; i++)
        for (int j = 0; j <= i; j++, s++) A[i][j] = column_of(sum, s);
    for (int i = 0; i < terms; i++, s++) y[i] = column_of(sum, s);
    for (int i = 0; i < 2; i++) {
        const d4 by = column_of(held, i);
        A[3 + i][3 + i] += either(by < HELD, by, four_d(HELD));
    }
    for (int i = OWN; i < terms; i++) A[i][i] += TWIN;
    factors f = {.there = column_of(sum, 0) >= terms + 3.0};
    solved(A, y, terms, &f);
    return f;
}

/* Solve for the steps of four cells, the first n of which are asked for. */
INLINE void solve(const double *const sum[4], const int terms, const double *const held[4], double *const out[4],
                  int n) {
    const factors f = factors_of(sum, terms, held);
    const d4 zero = four_d(0), all = column_of(sum, COUNTED), count = column_of(sum, 0);
    const d4 squares = column_of(sum, terms * (terms + 3) / 2);
    const d4 rss = either(squares > f.explained, squares - f.explained, zero);
    /* a term with a prior costs no degree of freedom: its spread is part of the model */
    const l4 free = (column_of(held, 0) > zero) + (column_of(held, 1) > zero); /* each a mask, -1 */
    const d4 noise = root_d(rss / (count - terms - __builtin_convertvector(free, d4)));
    const d4 clipped = (column_of(sum, CLIPPED) + all - count) / all;
    for (int m = 0; m < n; m++) {
        if (!f.there[m]) continue;
        double *o = out[m];
        o[0] = f.x[1][m], o[1] = f.x[2][m], o[2] = f.x[3][m], o[3] = f.x[4][m], o[4] = noise[m];
        o[5] = f.Q[0][m], o[6] = f.Q[1][m], o[7] = count[m], o[8] = clipped[m];
    }
}

/* Cells with as many terms, until there are four to be solved at a time. */
typedef struct {
    const double *sum[4], *held[4];
    double *out[4];
    int n;
} waiting;

INLINE void solve_waiting(waiting *w, const int terms) {
    if (!w->n) return;
    for (int m = w->n; m < 4; m++) w->sum[m] = w->sum[0], w->held[m] = w->held[0];
    solve(w->sum, terms, w->held, w->out, w->n);
    w->n = 0;
}

static void solve_all(waiting *w, int terms) {
    if (terms == OWN) solve_waiting(w, OWN);
    else if (terms == OWN + 1) solve_waiting(w, OWN + 1);
    else solve_waiting(w, OWN + 2);
}

/* Equations without pixels, with the twins whose steps reach into the cell. */
static void begin(equations *e, const double *twins, double below, double above, double half, double blur) {
    e->rows = NULL, e->left = NULL, e->dark = e->bright = 0, e->count = 0, e->clipped = (l4){0}, e->terms = OWN;
    for (int k = 0; k < 2; k++) {
        const double at = twins[2 * k], slope = twins[2 * k + 1], far = SPREAD * blur + half * fabs(slope);
        if (k ? at < above + far : at > -below - far) e->twins[e->terms++ - OWN] = (twin){at, slope, k ? 1 : -1};
    }
    for (int s = 0; s < e->terms * (e->terms + 1) / 2 + e->terms + 1; s++) e->sum[s] = four_d(0);
}

void VARIANT(step_sums)(const cc_picture *picture, int64_t n, const double *q, const double *normal,
                        const double *below, const double *above, const double *twins, double half_length, double blur,
                        double dark, double bright, double *sums) {
    for (int64_t i = 0; i < n; i++) {
        double *o = sums + CC_STEP_SUMS * i;
        memset(o, 0, CC_STEP_SUMS * sizeof *o);
        const double *at = q + 2 * i, *across = normal + 2 * i;
        equations e;
        begin(&e, twins + 4 * i, below[i], above[i], half_length, blur);
        e.dark = (float)dark, e.bright = (float)bright;
        if (!gather(picture, at, across, below[i], above[i], half_length, blur, &e)) continue;
        if ((e.sum[0][0] + e.sum[0][1]) + (e.sum[0][2] + e.sum[0][3]) < e.count) { /* some pixels are white */
            begin(&e, twins + 4 * i, below[i], above[i], half_length, blur);
            e.dark = (float)dark;
            gather_by_rows(picture, at, across, below[i], above[i], half_length, blur, (float)bright, &e);
        }
        const int used = e.terms * (e.terms + 1) / 2 + e.terms + 1;
        for (int s = 0; s < used; s++) o[s] = (e.sum[s][0] + e.sum[s][1]) + (e.sum[s][2] + e.sum[s][3]);
        o[COUNTED] = e.count, o[OF_TERMS] = e.terms;
        o[CLIPPED] = (double)((e.clipped[0] + e.clipped[1]) + (e.clipped[2] + e.clipped[3]));
    }
}

void VARIANT(steps)(int64_t n, const double *sums, const double *held, double *out) {
    waiting with[3] = {{.n = 0}}; /* by how many twins they have */
    for (int64_t i = 0; i < n; i++) {
        const double *s = sums + CC_STEP_SUMS * i;
        double *o = out + CC_STEP_TERMS * i;
        for (int k = 0; k < CC_STEP_TERMS; k++) o[k] = NAN;
        if (!(s[OF_TERMS] >= OWN && s[OF_TERMS] <= TERMS)) continue; /* the cell left the picture */
        const int twins = (int)s[OF_TERMS] - OWN;
        waiting *w = with + twins;
        w->sum[w->n] = s, w->held[w->n] = held + 2 * i, w->out[w->n] = o;
        if (++w->n == 4) solve_all(w, OWN + twins);
    }
    for (int twins = 0; twins < 3; twins++) solve_all(with + twins, OWN + twins);
}

void VARIANT(step_residuals)(const cc_picture *picture, int64_t n, const double *q, const double *normal,
                             const double *below, const double *above, const double *twins, double half_length,
                             double blur, double bright, const double *sums, int32_t bins, double width,
                             double *out) {
    static const double free[2] = {0, 0}, *const held[4] = {free, free, free, free};
    memset(out, 0, sizeof *out * (size_t)n * (size_t)(2 * bins + 1));
    for (int64_t i = 0; i < n; i++) {
        const double *s = sums + CC_STEP_SUMS * i;
        double *o = out + (2 * bins + 1) * i;
        residuals left = {.from = -0.5 * bins * width, .width = width, .sum = o, .number = o + bins, .count = bins};
        equations e;
        begin(&e, twins + 4 * i, below[i], above[i], half_length, blur);
        const int terms = e.terms, known = terms == (int)s[OF_TERMS];
        if (!known) continue;
        const factors f = factors_of((const double *const[4]){s, s, s, s}, terms, held);
        if (!f.there[0]) continue;
        for (int k = 0; k < terms; k++) left.x[k] = f.x[k][0];
        e.left = &left;
        gather_by_rows(picture, q + 2 * i, normal + 2 * i, below[i], above[i], half_length, blur, (float)bright, &e);
        o[2 * bins] = upper(s[terms * (terms + 1) / 2 + terms] - f.explained[0], 0) / (s[0] - terms);
    }
}
