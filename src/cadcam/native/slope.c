/* Extrema of the slope along profiles: cc_candidates of profile.h, compiled once for each instruction set. */
#include "hot.h"
#include "profile.h"
#include "vectors.h"

enum { LONGEST = 128, SIDE = 3 }; /* px of a profile; of the smoothing kernel to each side */

static int inside(const cc_picture *p, double x, double y) {
    return x >= 0 && y >= 0 && x < p->width - 1 && y < p->height - 1;
}

/* Places across a line from -reach to reach px, each the mean over `along` places beside each other. */
typedef struct {
    double x, y;         /* the first of the places along, at the line */
    double pace_x, pace_y;
    int along;
} strip;

static strip strip_of(const double *q, const double *n, double half_length) {
    const int along = imax((int)ceil(2 * half_length), 1);
    const double pace = 2 * half_length / along, first = 0.5 * pace - half_length;
    return (strip){q[0] - first * n[1], q[1] + first * n[0], -pace * n[1], pace * n[0], along};
}

/* Which places -reach + *from .. -reach + *to - 1 lie in the picture, with all that is averaged there. */
static void part_inside(const cc_picture *p, const strip *s, const double *n, int reach, int *from, int *to) {
    const double bx = s->x + (s->along - 1) * s->pace_x, by = s->y + (s->along - 1) * s->pace_y;
    *from = 0, *to = 2 * reach + 1;
    for (int k; *from < *to; ++*from) {
        k = *from - reach;
        if (inside(p, s->x + k * n[0], s->y + k * n[1]) && inside(p, bx + k * n[0], by + k * n[1])) break;
    }
    for (int k; *to > *from; --*to) {
        k = *to - 1 - reach;
        if (inside(p, s->x + k * n[0], s->y + k * n[1]) && inside(p, bx + k * n[0], by + k * n[1])) break;
    }
}

INLINE i8 at_most(i8 v, int32_t most) { return v - ((v > most) & (v - most)); }

/* Brightness at -reach .. reach px along the normal, averaged along the line; NaN outside the picture. `out` has room
 * for a vector more. */
static void profile(const cc_picture *p, const double *q, const double *n, double half_length, int reach, float *out) {
    const strip s = strip_of(q, n, half_length);
    int from, to;
    part_inside(p, &s, n, reach, &from, &to);
    for (int k = 0; k <= 2 * reach; k++) out[k] = NAN;
    if (from >= to) return;
    const int far = reach + (int)half_length + 2; /* places are relative to a nearby pixel: a float has few bits */
    const int32_t left = imax((int32_t)q[0] - far, 0), top = imax((int32_t)q[1] - far, 0);
    const int32_t right = p->width - 2 - left, bottom = p->height - 2 - top; /* rounding must not leave the picture */
    const float *pixels = p->pixels + (int64_t)top * p->width + left, share = 1.0f / (float)s.along;
    for (int k = from; k < to; k += 8) {
        const i8 place = at_most(k + *(const i8 *)LANE, to - 1); /* the last vector may be filled up */
        const f8 across = __builtin_convertvector(place - reach, f8);
        f8 x = across * (float)n[0] + (float)(s.x - left), y = across * (float)n[1] + (float)(s.y - top);
        f8 sum = eight(0);
        for (int j = 0; j < s.along; j++, x += (float)s.pace_x, y += (float)s.pace_y) {
            const i8 column = at_most(__builtin_convertvector(x, i8), right);
            const i8 row = at_most(__builtin_convertvector(y, i8), bottom);
            const i8 at = row * p->width + column;
            const f8 u = x - __builtin_convertvector(column, f8), v = y - __builtin_convertvector(row, f8);
            f8 a, b, c, d;
            pairs(pixels, at, &a, &b), pairs(pixels + p->width, at, &c, &d);
            const f8 above = fused(u, b - a, a), below = fused(u, d - c, c);
            sum += fused(v, below - above, above);
        }
        *(f8 *)(out + k) = sum * share;
    }
    for (int k = to; k <= 2 * reach; k++) out[k] = NAN;
}

/* Insert an extremum into the list of the strongest. */
static void insert(double at, double slope, int32_t most, double *offset, double *slopes) {
    for (int32_t i = 0; i < most; i++)
        if (isnan(slopes[i]) || fabs(slopes[i]) < fabs(slope)) {
            double o = offset[i], s = slopes[i];
            offset[i] = at, slopes[i] = slope, at = o, slope = s;
            if (isnan(slope)) return;
        }
}

/* The slope at places SIDE .. count - SIDE - 1 of a profile, smoothed by a Gaussian of 1 px. */
static void smoothed_slope(const float *values, int count, float *r) {
    static const float kernel[SIDE] = {0.24197072f, 0.10798193f, 0.013295546f}; /* k phi(k) */
    for (int k = SIDE; k < count - SIDE; k += 8) {
        f8 sum = eight(0);
        for (int j = 1; j <= SIDE; j++)
            sum += kernel[j - 1] * (*(const f8 *)(values + k + j) - *(const f8 *)(values + k - j));
        *(f8 *)(r + k) = sum;
    }
}

/* Which of eight places from r on are extrema no weaker than `least`: a bit for each. */
INLINE unsigned extrema(const float *r, float least) {
    const f8 here = *(const f8 *)r, size = size_of(here);
    const i8 sign = (i8)here & INT32_MIN;
    const f8 before = (f8)((i8)(*(const f8 *)(r - 1)) ^ sign), after = (f8)((i8)(*(const f8 *)(r + 1)) ^ sign);
    return signs((size >= least) & (size > before) & (size >= after));
}

void VARIANT(slope_extrema)(const cc_picture *picture, int64_t n, const double *q, const double *normal,
                            double half_length, int32_t reach, double least, int32_t most, double *offset,
                            double *slope) {
    float values[LONGEST + 16], r[LONGEST + 16]; /* vectors reach beyond the profile */
    const int within = imin(reach, LONGEST / 2 - SIDE - 2) + SIDE + 1, count = 2 * within + 1;
    for (int k = 0; k < LONGEST + 16; k++) values[k] = r[k] = NAN;
    for (int64_t i = 0; i < n; i++) {
        double *o = offset + i * most, *s = slope + i * most;
        for (int32_t k = 0; k < most; k++) o[k] = s[k] = NAN;
        profile(picture, q + 2 * i, normal + 2 * i, half_length, within, values);
        smoothed_slope(values, count, r);
        for (int first = SIDE + 1; first < count - SIDE - 1; first += 8) {
            unsigned left = extrema(r + first, (float)least) & ((1u << imin(count - SIDE - 1 - first, 8)) - 1);
            for (int k = first; left; left >>= 1, k++) {
                if (!(left & 1)) continue;
                const double here = fabs(r[k]), sign = r[k] < 0 ? -1 : 1;
                const double before = sign * r[k - 1], after = sign * r[k + 1];
                const double bend = before + after - 2 * here, shift = bend < 0 ? 0.5 * (before - after) / bend : 0;
                insert(k - within + shift, r[k], most, o, s);
            }
        }
    }
}
