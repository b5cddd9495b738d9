/* Vectors as GCC and clang have them (vector_size), with the few operations of AVX2 that have no operator; those
 * that are needed without it too are written out. */
#ifndef CADCAM_VECTORS_H
#define CADCAM_VECTORS_H

#include <math.h>
#include <stdint.h>
#ifdef __AVX2__
#include <immintrin.h>
#endif

typedef double d4 __attribute__((vector_size(32), may_alias, aligned(8)));
typedef int64_t l4 __attribute__((vector_size(32), may_alias, aligned(8)));
typedef float f8 __attribute__((vector_size(32), may_alias, aligned(4)));
typedef int32_t i8 __attribute__((vector_size(32), may_alias, aligned(4)));
typedef float f4 __attribute__((vector_size(16), may_alias, aligned(4)));
typedef int32_t i4 __attribute__((vector_size(16), may_alias, aligned(4)));
typedef uint16_t h16 __attribute__((vector_size(32), may_alias, aligned(2)));

#define INLINE static inline __attribute__((always_inline))

INLINE f8 load(const float *p) { return *(const f8 *)p; }

static const double COUNT[8] = {0, 1, 2, 3, 4, 5, 6, 7};
static const int32_t LANE[8] = {0, 1, 2, 3, 4, 5, 6, 7};

#ifdef __AVX2__
INLINE f8 choose(i8 mask, f8 yes, f8 no) { return (f8)_mm256_blendv_ps((__m256)no, (__m256)yes, (__m256)mask); }
INLINE f8 least_of(f8 a, f8 b) { return (f8)_mm256_min_ps((__m256)a, (__m256)b); }
INLINE f8 most_of(f8 a, f8 b) { return (f8)_mm256_max_ps((__m256)a, (__m256)b); }
INLINE f8 root(f8 v) { return (f8)_mm256_sqrt_ps((__m256)v); }
INLINE d4 root_d(d4 v) { return (d4)_mm256_sqrt_pd((__m256d)v); }
INLINE unsigned signs(i8 v) { return (unsigned)_mm256_movemask_ps((__m256)v); }
INLINE f8 floats(d4 a, d4 b) { return (f8)_mm256_set_m128(_mm256_cvtpd_ps((__m256d)b), _mm256_cvtpd_ps((__m256d)a)); }

INLINE h16 sixteen(const uint8_t *p) {
    return (h16)_mm256_cvtepu8_epi16(_mm_loadu_si128((const __m128i *)(const void *)p));
}

/* Eight records of four floats, number by number. */
INLINE void transposed(const float *const r[8], f8 out[4]) {
    __m256 p[4];
    for (int k = 0; k < 4; k++) {
        const __m256 low = _mm256_castps128_ps256(_mm_loadu_ps(r[k]));
        p[k] = _mm256_insertf128_ps(low, _mm_loadu_ps(r[k + 4]), 1);
    }
    const __m256 a = _mm256_unpacklo_ps(p[0], p[1]), b = _mm256_unpacklo_ps(p[2], p[3]);
    const __m256 c = _mm256_unpackhi_ps(p[0], p[1]), d = _mm256_unpackhi_ps(p[2], p[3]);
    out[0] = (f8)_mm256_shuffle_ps(a, b, 0x44), out[1] = (f8)_mm256_shuffle_ps(a, b, 0xEE);
    out[2] = (f8)_mm256_shuffle_ps(c, d, 0x44), out[3] = (f8)_mm256_shuffle_ps(c, d, 0xEE);
}

/* x0 y0 z0 x1 y1 z1 ... */
INLINE void interleaved(f8 x, f8 y, f8 z, f8 out[3]) {
    for (int k = 0; k < 3; k++) { /* number i of what comes out is component i % 3 of sample i / 3 */
        i8 from = 8 * k + *(const i8 *)LANE;
        from = (from * 43) >> 7; /* by 3, below 32 */
        const __m256i i = (__m256i)from;
        const __m256 a = _mm256_permutevar8x32_ps((__m256)x, i), b = _mm256_permutevar8x32_ps((__m256)y, i);
        const __m256 c = _mm256_permutevar8x32_ps((__m256)z, i);
        if (k == 0) out[0] = (f8)_mm256_blend_ps(_mm256_blend_ps(a, b, 0x92), c, 0x24);
        if (k == 1) out[1] = (f8)_mm256_blend_ps(_mm256_blend_ps(a, b, 0x24), c, 0x49);
        if (k == 2) out[2] = (f8)_mm256_blend_ps(_mm256_blend_ps(a, b, 0x49), c, 0x92);
    }
}

/* The low three bytes of each number, side by side. */
INLINE void three_bytes(i8 v, uint8_t out[24]) {
    const __m256i order = _mm256_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1,
                                           0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1);
    const __m256i packed = _mm256_shuffle_epi8((__m256i)v, order);
    const __m128i low = _mm256_castsi256_si128(packed), high = _mm256_extracti128_si256(packed, 1);
    const int32_t last = _mm_extract_epi32(high, 2);
    _mm_storeu_si128((__m128i *)(void *)out, low); /* four bytes too many: the next store has them right */
    _mm_storel_epi64((__m128i *)(void *)(out + 12), high);
    __builtin_memcpy(out + 20, &last, sizeof last);
}

/* Two pairs of numbers, side by side. */
INLINE __m128 two_pairs(const float *a, const float *b) {
    const __m128 low = _mm_castsi128_ps(_mm_loadl_epi64((const __m128i *)(const void *)a));
    return _mm_loadh_pi(low, (const __m64 *)(const void *)b);
}

/* Numbers p[at], and their neighbours p[at + 1]. They are loaded pair by pair: some processors gather slowly. */
INLINE void pairs(const float *p, i8 at, f8 *one, f8 *next) {
    const __m256 a = _mm256_set_m128(two_pairs(p + at[4], p + at[5]), two_pairs(p + at[0], p + at[1]));
    const __m256 b = _mm256_set_m128(two_pairs(p + at[6], p + at[7]), two_pairs(p + at[2], p + at[3]));
    *one = (f8)_mm256_shuffle_ps(a, b, 0x88), *next = (f8)_mm256_shuffle_ps(a, b, 0xDD);
}

INLINE f8 looked_up(const float table[8], i8 at) {
    return (f8)_mm256_permutevar8x32_ps(_mm256_loadu_ps(table), (__m256i)at);
}
#else
INLINE f8 choose(i8 mask, f8 yes, f8 no) { return (f8)(((i8)yes & mask) | ((i8)no & ~mask)); }
INLINE f8 least_of(f8 a, f8 b) { return choose(a < b, a, b); }
INLINE f8 most_of(f8 a, f8 b) { return choose(a > b, a, b); }
INLINE f8 root(f8 v) {
    for (int i = 0; i < 8; i++) v[i] = sqrtf(v[i]);
    return v;
}
INLINE d4 root_d(d4 v) {
    for (int i = 0; i < 4; i++) v[i] = sqrt(v[i]);
    return v;
}
INLINE unsigned signs(i8 v) {
    unsigned bits = 0;
    for (int i = 0; i < 8; i++) bits |= (unsigned)(v[i] < 0) << i;
    return bits;
}
INLINE f8 floats(d4 a, d4 b) {
    f8 v;
    for (int i = 0; i < 4; i++) v[i] = (float)a[i], v[i + 4] = (float)b[i];
    return v;
}
INLINE h16 sixteen(const uint8_t *p) {
    h16 v;
    for (int i = 0; i < 16; i++) v[i] = p[i];
    return v;
}
INLINE void pairs(const float *p, i8 at, f8 *one, f8 *next) {
    for (int i = 0; i < 8; i++) (*one)[i] = p[at[i]], (*next)[i] = p[at[i] + 1];
}
INLINE f8 looked_up(const float table[8], i8 at) {
    f8 v;
    for (int i = 0; i < 8; i++) v[i] = table[at[i]];
    return v;
}
INLINE void transposed(const float *const r[8], f8 out[4]) {
    for (int i = 0; i < 8; i++)
        for (int k = 0; k < 4; k++) out[k][i] = r[i][k];
}
INLINE void interleaved(f8 x, f8 y, f8 z, f8 out[3]) {
    float all[24];
    for (int i = 0; i < 8; i++) all[3 * i] = x[i], all[3 * i + 1] = y[i], all[3 * i + 2] = z[i];
    for (int k = 0; k < 3; k++) out[k] = *(const f8 *)(all + 8 * k);
}
INLINE void three_bytes(i8 v, uint8_t out[24]) {
    for (int i = 0; i < 8; i++)
        for (int k = 0; k < 3; k++) out[3 * i + k] = (uint8_t)(v[i] >> (8 * k));
}
#endif
#ifdef __FMA__
INLINE f8 fused(f8 a, f8 b, f8 c) { return (f8)_mm256_fmadd_ps((__m256)a, (__m256)b, (__m256)c); }
INLINE d4 fused_d(d4 a, d4 b, d4 c) { return (d4)_mm256_fmadd_pd((__m256d)a, (__m256d)b, (__m256d)c); }
#else
INLINE f8 fused(f8 a, f8 b, f8 c) { return a * b + c; }
INLINE d4 fused_d(d4 a, d4 b, d4 c) { return a * b + c; }
#endif
INLINE i8 bytes_at(const uint8_t *const p[8], i8 at) {
    return (i8){p[0][at[0]], p[1][at[1]], p[2][at[2]], p[3][at[3]],
                p[4][at[4]], p[5][at[5]], p[6][at[6]], p[7][at[7]]};
}
INLINE f8 eight(float v) { return v - (f8){0}; }
INLINE d4 four_d(double v) { return v - (d4){0}; }
INLINE f8 size_of(f8 v) { return (f8)((i8)v & INT32_MAX); }

#ifdef __AVX2__
INLINE d4 choose_d(l4 mask, d4 yes, d4 no) { return (d4)_mm256_blendv_pd((__m256d)no, (__m256d)yes, (__m256d)mask); }
INLINE d4 least_d(d4 a, d4 b) { return (d4)_mm256_min_pd((__m256d)a, (__m256d)b); }
INLINE d4 most_d(d4 a, d4 b) { return (d4)_mm256_max_pd((__m256d)a, (__m256d)b); }
INLINE d4 size_d(d4 v) { return most_d(v, -v); }
INLINE f8 up(f8 v) { return (f8)_mm256_ceil_ps((__m256)v); }
INLINE f8 down(f8 v) { return (f8)_mm256_floor_ps((__m256)v); }
INLINE d4 up_d(d4 v) { return (d4)_mm256_ceil_pd((__m256d)v); }
INLINE d4 down_d(d4 v) { return (d4)_mm256_floor_pd((__m256d)v); }
INLINE i8 whole(d4 a, d4 b) { /* of doubles that fit */
    return (i8)_mm256_set_m128i(_mm256_cvttpd_epi32((__m256d)b), _mm256_cvttpd_epi32((__m256d)a));
}
INLINE f4 choose_f(i4 mask, f4 yes, f4 no) { return (f4)_mm_blendv_ps((__m128)no, (__m128)yes, (__m128)mask); }
INLINE f4 most_f(f4 a, f4 b) { return (f4)_mm_max_ps((__m128)a, (__m128)b); }
INLINE f4 least_f(f4 a, f4 b) { return (f4)_mm_min_ps((__m128)a, (__m128)b); }
INLINE f4 size_f(f4 v) { return (f4)((i4)v & INT32_MAX); }
INLINE f4 narrow_d(d4 v) { return (f4)_mm256_cvtpd_ps((__m256d)v); }
INLINE i8 narrow(l4 a, l4 b) { /* masks */
    const f8 low = (f8)_mm256_shuffle_ps((__m256)a, (__m256)b, 0x88); /* a0 a1 b0 b1 | a2 a3 b2 b3 */
    return (i8)_mm256_castpd_si256(_mm256_permute4x64_pd((__m256d)low, 0xD8));
}
INLINE float least_lane(f8 v) {
    __m128 m = _mm_min_ps(_mm256_castps256_ps128((__m256)v), _mm256_extractf128_ps((__m256)v, 1));
    m = _mm_min_ps(m, _mm_movehl_ps(m, m));
    return _mm_cvtss_f32(_mm_min_ss(m, _mm_shuffle_ps(m, m, 1)));
}
INLINE unsigned signs_d(l4 v) { return (unsigned)_mm256_movemask_pd((__m256d)v); }
INLINE unsigned signs_f(i4 v) { return (unsigned)_mm_movemask_ps((__m128)v); }
#endif

#endif
