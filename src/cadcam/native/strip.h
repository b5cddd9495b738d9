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

/* The first and the last column of the spans of a strip, at least one of whose rows has samples. */
INLINE void columns_of(i8 left, i8 right, int32_t *first, int32_t *last) {
    const __m256i a = (__m256i)(left & INT32_MAX), b = (__m256i)~right; /* rows without samples come last */
    const __m128i p = _mm_min_epi32(_mm256_castsi256_si128(a), _mm256_extracti128_si256(a, 1));
    const __m128i q = _mm_min_epi32(_mm256_castsi256_si128(b), _mm256_extracti128_si256(b, 1));
    const __m128i two = _mm_min_epi32(_mm_unpacklo_epi32(p, q), _mm_unpackhi_epi32(p, q));
    const __m128i m = _mm_min_epi32(two, _mm_unpackhi_epi64(two, two));
    *first = _mm_cvtsi128_si32(m), *last = ~_mm_extract_epi32(m, 1);
}

/* Which of 4 tiles could show the triangle, as bits: by the largest 1/z in each and what it holds. */
INLINE unsigned may_show(const triangle *t, d4 largest, f4 farthest) {
    f4 w = __builtin_convertvector(largest, f4);
    const f4 near = t->nearest - (f4){0}, far = t->farthest - (f4){0};
    w = (f4)_mm_min_ps(_mm_max_ps((__m128)w, (__m128)far), (__m128)near);
    return 15 & ~signs_f(w < farthest);
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
