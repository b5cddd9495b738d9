/* Vectors as GCC and clang have them (vector_size), with the few operations of AVX that they have no sign for. */
#ifndef CADCAM_VECTORS_H
#define CADCAM_VECTORS_H

#include <immintrin.h>
#include <stdint.h>

typedef double d4 __attribute__((vector_size(32), may_alias, aligned(8)));
typedef int64_t l4 __attribute__((vector_size(32), may_alias, aligned(8)));
typedef float f8 __attribute__((vector_size(32), may_alias, aligned(4)));
typedef int32_t i8 __attribute__((vector_size(32), may_alias, aligned(4)));
typedef float f4 __attribute__((vector_size(16), may_alias, aligned(4)));
typedef int32_t i4 __attribute__((vector_size(16), may_alias, aligned(4)));

#define INLINE static inline __attribute__((always_inline))

static const double COUNT[8] = {0, 1, 2, 3, 4, 5, 6, 7};
static const int32_t LANE[8] = {0, 1, 2, 3, 4, 5, 6, 7};

INLINE f8 choose(i8 mask, f8 yes, f8 no) { return (f8)_mm256_blendv_ps((__m256)no, (__m256)yes, (__m256)mask); }
INLINE f8 least_of(f8 a, f8 b) { return (f8)_mm256_min_ps((__m256)a, (__m256)b); }
INLINE f8 most_of(f8 a, f8 b) { return (f8)_mm256_max_ps((__m256)a, (__m256)b); }
INLINE d4 choose_d(l4 mask, d4 yes, d4 no) { return (d4)_mm256_blendv_pd((__m256d)no, (__m256d)yes, (__m256d)mask); }
INLINE d4 least_d(d4 a, d4 b) { return (d4)_mm256_min_pd((__m256d)a, (__m256d)b); }
INLINE d4 most_d(d4 a, d4 b) { return (d4)_mm256_max_pd((__m256d)a, (__m256d)b); }
INLINE d4 size_d(d4 v) { return most_d(v, -v); }
INLINE f8 up(f8 v) { return (f8)_mm256_ceil_ps((__m256)v); }
INLINE f8 down(f8 v) { return (f8)_mm256_floor_ps((__m256)v); }
INLINE d4 up_d(d4 v) { return (d4)_mm256_ceil_pd((__m256d)v); }
INLINE d4 down_d(d4 v) { return (d4)_mm256_floor_pd((__m256d)v); }
INLINE f8 floats(d4 a, d4 b) { return (f8)_mm256_set_m128(_mm256_cvtpd_ps((__m256d)b), _mm256_cvtpd_ps((__m256d)a)); }
INLINE i8 whole(d4 a, d4 b) { /* of doubles that fit */
    return (i8)_mm256_set_m128i(_mm256_cvttpd_epi32((__m256d)b), _mm256_cvttpd_epi32((__m256d)a));
}
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
INLINE unsigned signs(i8 v) { return (unsigned)_mm256_movemask_ps((__m256)v); }
INLINE unsigned signs_d(l4 v) { return (unsigned)_mm256_movemask_pd((__m256d)v); }
INLINE unsigned signs_f(i4 v) { return (unsigned)_mm_movemask_ps((__m128)v); }

#endif
