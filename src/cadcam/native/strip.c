/* From a triangle to the tiles it covers, one strip of TILE rows of samples at a time.
 *
 * Spans. The samples of row y inside edge k, a x + t >= least with t = b y + c, are those from one on (a > 0) or up to
 * one (a < 0): rounded a x grows with x, and the sign of a rounded sum is that of the sum. In exact numbers that one is
 * where x meets X = -t / a. Here X is t m with m = -1 / a rounded: off by less than 2^-51 |X|, and a x by 2^-53 of
 * itself, so that up to |X| = 2^17 (pictures end before) only a sample within 2^-34 px of t m can be in doubt. Spans with
 * one within MARGIN are settled by the definition; all others are exact as they are.
 *
 * With a lens. In a patch of the picture the plane point of sample (x, y) is affine in x and y to within a measured
 * bound (patch.c). Edges moved outwards by that bound are lines of the picture, and the spans between them hold every
 * sample of the triangle; tile.c then decides sample by sample. */
#include "hot.h"
#ifdef __AVX2__ /* elsewhere tile_plain.c draws, with the same results */
#include "vectors.h"

#define MARGIN 0x1p-32

enum { CHUNK = 3 }; /* level of the blocks drawn through one patch: 8 x 8 tiles */

/* Where edges cross the rows of samples: at x = (b y + c) m. Those that bound from the left come first, those that bound
 * from the right last. */
typedef struct {
    double b[3], c[3], m[3];
    int lefts, rights;
    int unsure; /* numbers so large or small that only the definition is safe */
} crossings;

INLINE crossings crossings_of(const triangle *t, const double a[4], const double b[4], const double c[4]) {
    crossings e = {.unsure = (signs_d(*(const d4 *)t->size <= 1e250) & 7) != 7};
    double m[4];
    if (e.unsure) return e;
    *(d4 *)m = -1.0 / *(const d4 *)a;
    for (int k = 0; k < 3; k++) {
        if (!(fabs(a[k]) >= 1e-250)) continue;
        const int at = a[k] > 0 ? e.lefts++ : 2 - e.rights++;
        e.b[at] = b[k], e.c[at] = c[k], e.m[at] = m[k];
    }
    return e;
}

/* In the plane of the samples itself. Edges along the rows bound no row from a side: they cut rows off the rectangle. */
static crossings straight(const triangle *t, rect *r) {
    crossings e = crossings_of(t, t->a, t->b, t->c);
    if (e.lefts + e.rights == 3 || e.unsure) return e;
    for (int k = 0; k < 3; k++) {
        if (t->a[k] != 0) {
            e.unsure |= fabs(t->a[k]) < 1e-250;
            continue;
        }
        while (r->y0 <= r->y1 && !(t->b[k] * r->y0 + t->c[k] >= t->least[k])) r->y0++;
        while (r->y0 <= r->y1 && !(t->b[k] * r->y1 + t->c[k] >= t->least[k])) r->y1--;
    }
    return e;
}

/* In a patch of a distorting camera's picture, moved outwards. */
static crossings bent(const triangle *t, const patch *near) {
    const affine *p = &near->map;
    const d4 a = *(const d4 *)t->a, b = *(const d4 *)t->b;
    const d4 along = a * p->ux + b * p->vx, down = a * p->uy + b * p->vy;
    const d4 out = size_d(a) * p->off_u + size_d(b) * p->off_v + (size_d(along) + size_d(down)) * 0x1p-30;
    double ax[4], by[4], c[4];
    *(d4 *)ax = along, *(d4 *)by = down;
    *(d4 *)c = a * p->u + (b * p->v + *(const d4 *)t->c) + out - (along * near->x + down * near->y);
    return crossings_of(t, ax, by, c);
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

/* The spans of a strip within a rectangle; whether a sample may be in doubt. */
INLINE int cross_strip(const crossings *e, const rect *r, int32_t y0, spans *s) {
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
    return signs_d(apart < MARGIN) != 0;
}

/* The smallest of each half: of one number in lane 0, of the other in lane 1. */
INLINE void least_two(i8 one, i8 other, int32_t *least, int32_t *of_other) {
    const __m256i a = (__m256i)one, b = (__m256i)other;
    const __m128i p = _mm_min_epi32(_mm256_castsi256_si128(a), _mm256_extracti128_si256(a, 1));
    const __m128i q = _mm_min_epi32(_mm256_castsi256_si128(b), _mm256_extracti128_si256(b, 1));
    const __m128i two = _mm_min_epi32(_mm_unpacklo_epi32(p, q), _mm_unpackhi_epi32(p, q));
    const __m128i m = _mm_min_epi32(two, _mm_unpackhi_epi64(two, two));
    *least = _mm_cvtsi128_si32(m), *of_other = _mm_extract_epi32(m, 1);
}

/* Which of 4 tiles could show the triangle, as bits: by the largest 1/z in each and what it holds. */
INLINE unsigned may_show(const triangle *t, d4 largest, f4 farthest) {
    f4 w = __builtin_convertvector(largest, f4);
    const f4 near = t->nearest - (f4){0}, far = t->farthest - (f4){0};
    w = (f4)_mm_min_ps(_mm_max_ps((__m128)w, (__m128)far), (__m128)near);
    return 15 & ~signs_f(w < farthest);
}

INLINE d4 largest_in(const triangle *t, const cc_lens *lens, size_t tile) {
    const double *const *side = (const double *const *)lens->side;
    const double *x = side[t->a[3] > 0] + tile, *y = side[2 + (t->b[3] > 0)] + tile;
    return t->a[3] * *(const d4 *)x + (t->b[3] * *(const d4 *)y + t->c[3]);
}

static void draw_strip(const band *b, const triangle *t, const crossings *e, const rect *r, int32_t ty, int bent) {
    const cc_lens *lens = b->frame->view->lens;
    const int32_t y0 = ty * TILE;
    spans s;
    if (cross_strip(e, r, y0, &s) && !bent && !e->unsure) settle(t, y0, &s);
    const i8 row = y0 + *(const i8 *)LANE, beyond = (row < r->y0) | (row > r->y1);
    i8 left = *(const i8 *)s.left | (beyond & INT32_MAX), right = *(const i8 *)s.right | beyond;
    const i8 none = left > right;
    if (signs(none) == 0xFF) return;
    left |= none & INT32_MAX, right |= none;
    *(i8 *)s.left = left, *(i8 *)s.right = right;
    int32_t x0, x1;
    least_two(left & INT32_MAX, ~right, &x0, &x1);
    x0 /= TILE, x1 = ~x1 / TILE;

    const size_t wide = (size_t)b->frame->tiles_x;
    const float *farthest = b->worker->farthest + (size_t)(ty - b->first_tiles) * wide;
    const double at_y = t->b[3] * (t->b[3] > 0 ? imin(y0 + TILE - 1, r->y1) : imax(y0, r->y0)) + t->c[3];
    for (int32_t tx = x0; tx <= x1; tx += 4) {
        d4 largest;
        if (bent)
            largest = largest_in(t, lens, (size_t)ty * wide + (size_t)tx);
        else {
            const d4 from = tx * TILE + TILE * *(const d4 *)COUNT, to = least_d(from + (TILE - 1), r->x1 - (d4){0});
            largest = t->a[3] * (t->a[3] > 0 ? to : most_d(from, r->x0 - (d4){0})) + at_y;
        }
        unsigned show = may_show(t, largest, *(const f4 *)(farthest + tx));
        if (x1 - tx < 3) show &= (2u << (x1 - tx)) - 1;
        for (; show; show &= show - 1) {
            const int32_t x = tx + __builtin_ctz(show);
            const unsigned rows = signs((left <= x * TILE + (TILE - 1)) & (right >= x * TILE));
            if (!rows) continue;
            if (e->unsure) VARIANT(draw_by_definition)(b, t, rows, x, ty);
            else if (bent) VARIANT(draw_points)(b, t, x, ty);
            else VARIANT(draw_pixels)(b, t, &s, rows, x, ty);
        }
    }
}

static void draw_strips(const band *b, const triangle *t, const crossings *e, const rect *r, int bent) {
    for (int32_t ty = r->y0 / TILE; ty <= r->y1 / TILE; ty++) draw_strip(b, t, e, r, ty, bent);
}

/* Descend into the blocks of the picture that the triangle meets, as far as the lens is nearly affine. */
static void draw_block(const band *b, const triangle *t, const rect *r, int level, int32_t bx, int32_t by) {
    const cc_lens *lens = b->frame->view->lens;
    const int shift = level + 3; /* TILE = 1 << 3 */
    const rect here = {imax(r->x0, bx << shift), imin(r->x1, ((bx + 1) << shift) - 1),
                       imax(r->y0, by << shift), imin(r->y1, ((by + 1) << shift) - 1)};
    const box area = area_of(b->frame, r, level, bx, by);
    if (misses(t, &area)) return;
    if (level == CHUNK) {
        const crossings e = bent(t, block_patch(lens, CHUNK, bx, by));
        draw_strips(b, t, &e, &here, 1);
        return;
    }
    for (int32_t y = here.y0 >> (shift - 1); y <= here.y1 >> (shift - 1); y++)
        for (int32_t x = here.x0 >> (shift - 1); x <= here.x1 >> (shift - 1); x++) draw_block(b, t, r, level - 1, x, y);
}

void VARIANT(draw_triangle)(const band *b, const triangle *t, const rect *r) {
    rect s = *r;
    if (!b->frame->view->lens) {
        const crossings e = straight(t, &s);
        draw_strips(b, t, &e, &s, 0);
        return;
    }
    int level = CHUNK;
    if (s.x1 - s.x0 < PATCH && s.y1 - s.y0 < PATCH) {
        const crossings e = bent(t, patch_of(b->frame->view->lens, &s));
        draw_strips(b, t, &e, &s, 1);
        return;
    }
    while ((s.x1 >> (level + 3)) - (s.x0 >> (level + 3)) > 1 || (s.y1 >> (level + 3)) - (s.y0 >> (level + 3)) > 1) level++;
    for (int32_t y = s.y0 >> (level + 3); y <= s.y1 >> (level + 3); y++)
        for (int32_t x = s.x0 >> (level + 3); x <= s.x1 >> (level + 3); x++) draw_block(b, t, r, level, x, y);
}
#endif
