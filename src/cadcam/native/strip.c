/* From a triangle to the tiles it covers, one strip of TILE rows of samples at a time.
 *
 * Spans. The samples of row y inside edge k, a x + t >= least with t = b y + c, are those from one on (a > 0) or up to
 * one (a < 0): rounded a x grows with x, and the sign of a rounded sum is that of the sum. In exact numbers that one is
 * where x meets X = -t / a. Here X is t m with m = -1 / a rounded: off by less than 2^-51 |X|, and a x by 2^-53 of
 * itself, so that up to |X| = 2^17 (pictures end before) only a sample within 2^-34 px of t m can be in doubt. Spans
 * with one within MARGIN are settled by the definition; all others are exact as they are.
 *
 * Most spans are found in float, eight rows at a time: with X = x + y j about the first column and row, both x and y
 * are rounded by 2^-24 of themselves and so is the sum, which puts X off by less than 2^-21 (|x| + |y| j), what doubles
 * before it lost included. Where a sample lies as near as that, doubles decide. */
#include "hot.h"
#ifdef __AVX2__ /* elsewhere tile_plain.c draws, with the same results */
#include "strip.h"

#define MARGIN 0x1p-32

enum { STRIPS = 16 }; /* crossed at a time */

/* Where edges cross the rows of samples, at x = (b y + c) m. Those that bound from the left come first, those that
 * bound from the right last. */
typedef struct {
    double b[3], c[3], m[3];
    int lefts, rights;
    int unsure; /* numbers so large or small that only the definition is safe */
} crossings;

/* In the plane of the samples itself. Edges along the rows bound none from a side: they cut rows off the rectangle. */
static crossings straight(const triangle *t, rect *r) {
    crossings e = {.unsure = extreme(t)};
    if (e.unsure) return e;
    for (int k = 0; k < 3; k++) {
        if (fabs(t->a[k]) >= 1e-250) {
            const int at = t->a[k] > 0 ? e.lefts++ : 2 - e.rights++;
            e.b[at] = t->b[k], e.c[at] = t->c[k], e.m[at] = -1 / t->a[k];
            continue;
        }
        e.unsure |= t->a[k] != 0;
        if (t->a[k] != 0) continue;
        while (r->y0 <= r->y1 && !(t->b[k] * r->y0 + t->c[k] >= t->least[k])) r->y0++;
        while (r->y0 <= r->y1 && !(t->b[k] * r->y1 + t->c[k] >= t->least[k])) r->y1--;
    }
    return e;
}

/* The sample at the end of a span may be one too far: let the definition decide. */
static __attribute__((noinline)) void settle(const triangle *t, int32_t y0, spans *s) {
    for (int r = 0; r < TILE; r++) {
        int at_left = 1, at_right = 1;
        for (int k = 0; k < 3; k++) {
            const double row = t->b[k] * (y0 + r) + t->c[k];
            if (t->a[k] > 0) at_left &= t->a[k] * s->left[r] + row >= t->least[k];
            if (t->a[k] < 0) at_right &= t->a[k] * s->right[r] + row >= t->least[k];
        }
        s->left[r] += !at_left, s->right[r] -= !at_right;
    }
}

/* The spans of a strip within a rectangle; whether there are any. */
INLINE int cross_strip(const triangle *t, const crossings *e, const rect *r, int32_t y0, spans *s) {
    const d4 none = {0}, half = none + 0.5;
    d4 left[2], right[2], row[2];
    for (int h = 0; h < 2; h++) {
        row[h] = y0 + *(const d4 *)(COUNT + 4 * h);
        left[h] = r->x0 - half, right[h] = r->x1 + half;
    }
    for (int k = 0; k < e->lefts; k++)
        for (int h = 0; h < 2; h++) left[h] = most_d(left[h], (e->b[k] * row[h] + e->c[k]) * e->m[k]);
    for (int k = 3 - e->rights; k < 3; k++)
        for (int h = 0; h < 2; h++) right[h] = least_d(right[h], (e->b[k] * row[h] + e->c[k]) * e->m[k]);
    d4 first[2], last[2], apart = half;
    for (int h = 0; h < 2; h++) { /* kept beside the rectangle, where they fit an integer */
        left[h] = least_d(left[h], r->x1 + 3 * half), right[h] = most_d(right[h], r->x0 - 3 * half);
        first[h] = up_d(left[h] - MARGIN), last[h] = down_d(right[h] + MARGIN);
        apart = least_d(apart, least_d(first[h] - left[h], right[h] - last[h]));
    }
    *(i8 *)s->left = whole(first[0], first[1]), *(i8 *)s->right = whole(last[0], last[1]);
    if (signs_d(apart < MARGIN) && !e->unsure) settle(t, y0, s);
    return keep_spans(s, *(const i8 *)s->left, *(const i8 *)s->right, r, y0);
}

/* Edges of four triangles in float, about the first column and the first row of the first strip of each: two edges from
 * the left, two from the right (one of them twice), at x + y j, each side off by less than `off`; for which of them
 * this says enough, as bits. */
typedef struct {
    f4 x[4], y[4], off[2];
    unsigned fit;
} quick;

/* The edge that is alone on its side, and the two others. */
typedef struct { f4 alone, one, other; } sided;

INLINE sided by_side(const f4 v[3], const i4 left[3]) {
    const i4 first = left[1] == left[2], last = left[0] == left[1];
    const f4 alone = choose_f(first, v[0], choose_f(last, v[2], v[1]));
    return (sided){alone, choose_f(first, v[1], v[0]), choose_f(last, v[1], v[2])};
}

INLINE quick quick_of(const quartet *q, const rect r[4]) {
    double top[4], high[4], x0[4];
    for (int m = 0; m < 4; m++)
        top[m] = r[m].y0 / TILE * TILE, high[m] = r[m].y1 - r[m].y0 / TILE * TILE + TILE, x0[m] = r[m].x0;
    f4 x[3], y[3], off[3];
    i4 left[3];
    l4 fit = ~(l4){0};
    for (int k = 0; k < 3; k++) {
        const d4 a = q->a[k], b = q->b[k], size = q->size[k], m = -1.0 / a;
        const d4 yk = b * m, xk = (b * *(const d4 *)top + q->c[k]) * m - *(const d4 *)x0;
        const d4 offk = (size_d(xk) + size_d(yk) * *(const d4 *)high) * 0x1p-21 + 0x1p-20;
        fit &= (size >= 1e-250) & (size <= 1e250) & (size_d(a) >= 1e-250) & (offk < 0.25);
        x[k] = narrow_d(xk), y[k] = narrow_d(yk), off[k] = narrow_d(offk), left[k] = (i4)narrow_d(m) < 0;
    }
    const sided X = by_side(x, left), Y = by_side(y, left), off_of = by_side(off, left);
    const i4 same = (left[0] == left[1]) & (left[1] == left[2]);
    const i4 more = left[0] + left[1] + left[2] < -1; /* on the left */
    const f4 off_both = most_f(off_of.one, off_of.other);
    return (quick){.x = {choose_f(more, X.one, X.alone), choose_f(more, X.other, X.alone),
                         choose_f(more, X.alone, X.one), choose_f(more, X.alone, X.other)},
                   .y = {choose_f(more, Y.one, Y.alone), choose_f(more, Y.other, Y.alone),
                         choose_f(more, Y.alone, Y.one), choose_f(more, Y.alone, Y.other)},
                   .off = {choose_f(more, off_both, off_of.alone), choose_f(more, off_of.alone, off_both)},
                   .fit = signs_d(fit) & ~signs_f(same)};
}

/* The spans of strip k of the rectangle of triangle m; whether there are any, or -1 where that is in doubt. */
INLINE int cross_quickly(const quick *q, int m, const rect *r, int32_t k, spans *s) {
    const f8 j = __builtin_convertvector(k * TILE + *(const i8 *)LANE, f8);
    const f8 start = eight(-0.5f), end = eight((float)(r->x1 - r->x0) + 0.5f);
    const f8 left = most_of(fused(j, eight(q->y[0][m]), eight(q->x[0][m])),
                            fused(j, eight(q->y[1][m]), eight(q->x[1][m])));
    const f8 right = least_of(fused(j, eight(q->y[2][m]), eight(q->x[2][m])),
                              fused(j, eight(q->y[3][m]), eight(q->x[3][m])));
    const f8 first = up(most_of(left - q->off[0][m], start)), last = down(least_of(right + q->off[1][m], end));
    const f8 first_sure = up(most_of(left + q->off[0][m], start));
    const f8 last_sure = down(least_of(right - q->off[1][m], end));
    if (signs((first != first_sure) | (last != last_sure))) return -1;
    const i8 from = r->x0 + __builtin_convertvector(first, i8), to = r->x0 + __builtin_convertvector(last, i8);
    return keep_spans(s, from, to, r, (r->y0 / TILE + k) * TILE);
}

/* Draw the spans of a strip, all their samples in doubt or none. */
INLINE void draw_spans(const band *b, const triangle *t, const rect *r, int32_t ty, const spans *s, int unsure) {
    const unsigned doubt = unsure ? 0xFF : 0;
    const int32_t y0 = ty * TILE;
    const i8 left = *(const i8 *)s->left, right = *(const i8 *)s->right;
    int32_t from, to;
    columns_of(left, right, &from, &to);
    const int32_t x0 = from / TILE, x1 = to / TILE;
    const float *farthest = b->sheet->farthest + (size_t)(ty - b->first_tiles) * (size_t)b->grid->tiles_x;
    const double a = t->a[3], at_y = t->b[3] * (t->b[3] > 0 ? imin(y0 + TILE - 1, r->y1) : imax(y0, r->y0)) + t->c[3];
    if (x0 == x1) { /* most: a few numbers instead of vectors */
        const float w = (float)(a * (a > 0 ? to : from) + at_y), kept = w > t->farthest ? w : t->farthest;
        if ((kept < t->nearest ? kept : t->nearest) < farthest[x0]) return;
        const unsigned rows = signs(left <= right);
        VARIANT(draw_tile)(b, t, s, rows, doubt & rows, x0, ty);
        return;
    }
    for (int32_t tx = x0; tx <= x1; tx += 4) {
        const d4 first = tx * TILE + TILE * *(const d4 *)COUNT, last = least_d(first + (TILE - 1), r->x1 - (d4){0});
        const d4 largest = a * (a > 0 ? last : most_d(first, r->x0 - (d4){0})) + at_y;
        unsigned show = may_show(t, largest, *(const f4 *)(farthest + tx));
        if (x1 - tx < 3) show &= (2u << (x1 - tx)) - 1;
        for (; show; show &= show - 1) {
            const int32_t x = tx + __builtin_ctz(show);
            const unsigned rows = signs((left <= x * TILE + (TILE - 1)) & (right >= x * TILE));
            if (rows) VARIANT(draw_tile)(b, t, s, rows, doubt & rows, x, ty);
        }
    }
}

/* Numbers that float does not hold, edges along the rows, triangles that reach behind the camera. */
static void draw_oddly(const band *b, const triangle *t, rect r) {
    const crossings e = straight(t, &r);
    for (int32_t ty = r.y0 / TILE; ty <= r.y1 / TILE; ty++) {
        spans s;
        if (!strip_hidden(b, t->nearest, r.x0, r.x1, ty) && cross_strip(t, &e, &r, ty * TILE, &s))
            draw_spans(b, t, &r, ty, &s, e.unsure);
    }
}

/* Where float leaves it in doubt. */
static __attribute__((noinline)) int cross_surely(const quartet *q, int m, rect r, int32_t y0, spans *s) {
    const triangle t = triangle_of(q, m);
    const crossings e = straight(&t, &r);
    return cross_strip(&t, &e, &r, y0, s);
}

/* Many triangles have samples in few of the strips that they pass: all are crossed before any is drawn. */
static void draw_straight(const band *b, const quartet *of, const quick *q, int m, const rect *r) {
    const int32_t top = r->y0 / TILE, strips = r->y1 / TILE - top + 1;
    spans s[STRIPS];
    for (int32_t start = 0; start < strips; start += STRIPS) {
        const int n = imin(STRIPS, strips - start);
        unsigned found = 0;
        for (int k = 0; k < n; k++) {
            int any = cross_quickly(q, m, r, start + k, &s[k]);
            if (any < 0) any = cross_surely(of, m, *r, (top + start + k) * TILE, &s[k]);
            found |= (unsigned)any << k;
        }
        if (!found) continue;
        const triangle t = plane_of(of, m);
        for (; found; found &= found - 1) {
            const int k = __builtin_ctz(found);
            draw_spans(b, &t, r, top + start + k, &s[k], 0);
        }
    }
}

/* All four are taken apart at once, in vectors. */
static void draw_bent(const band *b, const quartet *of, const rect r[4], unsigned which) {
    const triangle t[4] = {triangle_of(of, 0), triangle_of(of, 1), triangle_of(of, 2), triangle_of(of, 3)};
    for (; which; which &= which - 1) {
        const int m = __builtin_ctz(which);
        VARIANT(draw_through_lens)(b, &t[m], &r[m]);
    }
}

static void draw_flat(const band *b, const quartet *of, const rect r[4], unsigned which) {
    const quick q = quick_of(of, r);
    for (; which; which &= which - 1) {
        const int m = __builtin_ctz(which);
        if (q.fit >> m & 1) {
            draw_straight(b, of, &q, m, &r[m]);
            continue;
        }
        const triangle t = triangle_of(of, m);
        draw_oddly(b, &t, r[m]);
    }
}

void VARIANT(draw_quartet)(const band *b, const quartet *of, const rect r[4], unsigned which) {
    if (b->grid->lens) draw_bent(b, of, r, which);
    else draw_flat(b, of, r, which);
}
#endif
