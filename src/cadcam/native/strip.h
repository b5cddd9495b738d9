/* A triangle in one strip of TILE rows of samples: which tiles its spans show in. For strip.c and bent.c. */
#ifndef CADCAM_STRIP_H
#define CADCAM_STRIP_H

#include "hot.h"
#include "vectors.h"

/* Numbers so large or small that only the definition is safe. */
INLINE int extreme(const triangle *t) {
    const d4 size = *(const d4 *)t->size;
    return (signs_d((size >= 1e-250) & (size <= 1e250)) & 7) != 7;
}

/* Keep the spans of a strip's rows in a rectangle; whether there are any. */
INLINE int keep_spans(spans *s, i8 left, i8 right, const rect *r, int32_t y0) {
    const i8 row = y0 + *(const i8 *)LANE, none = (left > right) | (row < r->y0) | (row > r->y1);
    *(i8 *)s->left = left | (none & INT32_MAX), *(i8 *)s->right = right | none;
    return signs(none) != 0xFF;
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

/* Draw the spans of a strip. With a lens, samples outside `sure` but inside `s` are in doubt. */
INLINE void draw_spans(const band *b, const triangle *t, const rect *r, int32_t ty, const spans *s, const spans *sure,
                       int unsure) {
    const cc_lens *lens = b->grid->lens;
    const int32_t y0 = ty * TILE;
    const i8 left = *(const i8 *)s->left, right = *(const i8 *)s->right;
    int32_t x0, x1;
    least_two(left & INT32_MAX, ~right, &x0, &x1);
    x0 /= TILE, x1 = ~x1 / TILE;

    const size_t wide = (size_t)b->grid->tiles_x, of_lens = (size_t)ty * wide;
    const float *farthest = b->sheet->farthest + (size_t)(ty - b->first_tiles) * wide;
    const double at_y = t->b[3] * (t->b[3] > 0 ? imin(y0 + TILE - 1, r->y1) : imax(y0, r->y0)) + t->c[3];
    for (int32_t tx = x0; tx <= x1; tx += 4) {
        d4 largest;
        if (sure)
            largest = largest_in(t, lens, of_lens + (size_t)tx);
        else {
            const d4 from = tx * TILE + TILE * *(const d4 *)COUNT, to = least_d(from + (TILE - 1), r->x1 - (d4){0});
            largest = t->a[3] * (t->a[3] > 0 ? to : most_d(from, r->x0 - (d4){0})) + at_y;
        }
        unsigned show = may_show(t, largest, *(const f4 *)(farthest + tx));
        if (x1 - tx < 3) show &= (2u << (x1 - tx)) - 1;
        for (; show; show &= show - 1) {
            const int32_t x = tx + __builtin_ctz(show), first = x * TILE, last = first + (TILE - 1);
            const unsigned rows = signs((left <= last) & (right >= first));
            if (!rows) continue;
            unsigned doubt = unsure || (sure && lens->partial[of_lens + (size_t)x]) ? 0xFF : 0;
            if (sure) {
                const i8 from = *(const i8 *)sure->left, to = *(const i8 *)sure->right;
                doubt |= signs(((left < from) & (from > first)) | ((right > to) & (to < last)));
            }
            VARIANT(draw_tile)(b, t, s, rows, doubt & rows, x, ty);
        }
    }
}

/* Whether what is no nearer than 1/z = nearest is hidden in the samples x0 to x1 of a strip. */
INLINE int strip_hidden(const band *b, float nearest, int32_t x0, int32_t x1, int32_t ty) {
    const float *row = b->sheet->farthest + (size_t)(ty - b->first_tiles) * (size_t)b->grid->tiles_x;
    x1 /= TILE;
    for (int32_t x = x0 / TILE; x <= x1; x += 8)
        if (signs((*(const f8 *)(row + x) <= nearest) & (*(const i8 *)LANE <= x1 - x))) return 0;
    return 1;
}

#endif
