/* From a triangle to the tiles it covers, seen through a lens: strips as in strip.c, their edges bent.
 *
 * In a bend (patch.c), with i and j counted from its middle, at most J in size,
 *     |P / A - F| <= s,   F = i - X0 + D(i),   X0 = x + y j,   D(i) = D2 + D3,
 *     D2 = p i j + q j j + r i i,   D3 = s0 i i i + s1 i i j + s2 i j j + s3 j j j,
 *     s = (|a| off_u + |b| off_v + 2^-48 size + 2^-14 |B|) / |A|,   size >= |a x| + |b y| + |c| everywhere,
 * where A i + B j + C is the linear part of P: A = a ux + b vx and its like are off by a few 2^-53 size, and so is P; A
 * is kept at least 2^-20 |B| in size, which moves the sum by less than 2^-14 |B|. Let |X0| <= R, and write n for
 * i - X0, d for the slope p j + 2 r X0 of D2 at X0, and D for the values at X0. Then D2(i) = D2 + d n + r n n, D3
 * differs from its value there by at most `steep` |n|, and with X = X0 - (1 - d) D2 - D3, of third order in j,
 *     (1 - d) F = i - X - d d n - d D3 + (1 - d) (r n n + steep n),   |n| <= |i - X| + bulge,   |n| <= 2 R,
 * with bulge >= |X - X0|, and the sizes of d and the rest at most those of their bounds. So F has the sign of i - X and
 * exceeds s where |i - X| (1 - e) > k + (1 + d) s,
 *     e = d d + (1 + d) (2 R |r| + steep),   k = d d bulge + d |D3| + (1 + d) bulge (|r| bulge + steep),
 * and 1 / (1 - e) is at most 1 + 3/2 e up to e = 1/3; for n n <= |n| |i - X| + |n| bulge, whose last part is at most
 * bulge |i - X| + bulge bulge, and J + R + bulge <= 2 R. These are required: bulge + s <= R - J, with d <= 1/4 and
 * e <= 1/3. X is X0 with its curvature cut to +-bulge, which cuts nothing up to R. Where |X0| > R it keeps X beyond
 * every sample on the side of X0, where F has the sign of -X0 and more than s, since |D(i)| <= bulge: what is decided
 * is right there too. Edges too flat for these requirements have all of D in s. Numbers in float are off by less than
 * `rounding`. Samples within the sum of these of X are in doubt, and rows with such samples are drawn by P; all others
 * are decided.
 *
 * Which samples of a strip a triangle may reach at all follows without curvature: those inside have, up to a sign,
 * F >= -s, so that i >= X0 - s - |D(i)|. */
#include "hot.h"
#ifdef __AVX2__ /* without it tile_plain.c draws, with the same results */
#include "strip.h"

enum { CHUNK = 3 }; /* level of the blocks drawn through one bend: 8 x 8 tiles */

/* The largest 1/z of a triangle in a box. */
INLINE float nearest_of(const triangle *t, const box *area) {
    const float w = (float)most(t, 3, area);
    return w < t->nearest ? (w > t->farthest ? w : t->farthest) : t->nearest; /* NaN: of its corners */
}

/* The edges of a triangle in a bend: where each meets row j, at x + y j + cut(k0 + k1 j + k2 j j + k3 j j j), cut() to
 * +-bulge, samples nearer than `off` in doubt; and how far from x + y j, in a strip about row j, samples are inside. */
typedef struct {
    float x[4], y[4], k0[4], k1[4], k2[4], k3[4], bulge[4], off[4], reach[4];
    unsigned rights;
} bows;

INLINE bows bows_of(const triangle *t, const bend *at) {
    const affine *map = &at->map;
    const d4 a = *(const d4 *)t->a, b = *(const d4 *)t->b, none = {0};
    const d4 B = a * map->uy + b * map->vy, C = a * map->u + (b * map->v + *(const d4 *)t->c);
    d4 A = a * map->ux + b * map->vx;
    const d4 least = most_d(size_d(B) * 0x1p-20, none + 1e-300);
    A = choose_d(A < none, least_d(A, -least), most_d(A, least));
    const d4 m = 1.0 / A, am = a * m, bm = b * m;
    const d4 slack = size_d(am) * map->off_u + size_d(bm) * map->off_v +
                     size_d(m) * (*(const d4 *)t->size * 0x1p-48 + size_d(B) * 0x1p-14);

    /* x is cut to 2^33, more than y and the curvature make up for: numbers that are not finite do not arise there */
    const f4 x = narrow_d(most_d(least_d(-C * m, none + 0x1p33), none - 0x1p33)), y = narrow_d(-B * m);
    f4 r = narrow_d(am * at->u2[0] + bm * at->v2[0]), p = narrow_d(am * at->u2[1] + bm * at->v2[1]);
    f4 q = narrow_d(am * at->u2[2] + bm * at->v2[2]);
    f4 s0 = narrow_d(am * at->u3[0] + bm * at->v3[0]), s1 = narrow_d(am * at->u3[1] + bm * at->v3[1]);
    f4 s2 = narrow_d(am * at->u3[2] + bm * at->v3[2]), s3 = narrow_d(am * at->u3[3] + bm * at->v3[3]);

    const float J = (float)at->half;
    const f4 zero = {0}, s = narrow_d(slack * (1 + 0x1p-20)), N = size_f(x) + J * size_f(y);
    const f4 P = size_f(p), Q = size_f(q), r1 = size_f(r);
    const f4 S0 = size_f(s0), S1 = size_f(s1), S2 = size_f(s2), S3 = size_f(s3);
    const f4 h = S0 + S1 + S2 + S3, flat = s + J * J * (P + Q + r1 + J * h), R = J + 2 * flat;
    const f4 d = J * P + 2 * R * r1, cubic = R * R * R * h, steep = R * (3 * R * S0 + 2 * J * S1) + J * J * S2;
    const f4 bulge = (1 + d) * (R * (J * P + R * r1) + J * J * Q) + cubic, e = d * d + (1 + d) * (2 * R * r1 + steep);
    const i4 bent = (bulge + s <= R - J) & (d <= 0.25f) & (e <= 0.33f);
    const f4 k = d * d * bulge + d * cubic + (1 + d) * bulge * (r1 * bulge + steep);
    const f4 wide = (k + (1 + d) * s) * (1 + 1.5f * e);
    const f4 n = (P * J + r1 * N) * N + J * J * Q, M = N + J;
    const f4 rounding = N * 0x1p-22f + 0x1p-16f + (n * (1 + J * P + 2 * r1 * N) + M * M * M * h) * 0x1p-20f;
    f4 off = (f4)(((i4)(wide + rounding) & bent) | ((i4)(flat + N * 0x1p-22f + 0x1p-16f) & ~bent));
    off = least_f(off, 0x1p36f - zero);
    p = (f4)((i4)p & bent), q = (f4)((i4)q & bent), r = (f4)((i4)r & bent);
    s0 = (f4)((i4)s0 & bent), s1 = (f4)((i4)s1 & bent), s2 = (f4)((i4)s2 & bent), s3 = (f4)((i4)s3 & bent);

    /* along X0 = x + y j: D2 = g0 + g1 j + g2 j j, d = h0 + h1 j, D3 = t0 + t1 j ... */
    const f4 h0 = 2 * r * x, h1 = p + 2 * r * y, g0 = r * x * x, g1 = x * h1, g2 = q + y * (p + r * y);
    const f4 t0 = x * x * x * s0, t1 = x * x * (s1 + 3 * s0 * y), t2 = x * (s2 + y * (2 * s1 + 3 * s0 * y));
    const f4 t3 = s3 + y * (s2 + y * (s1 + y * s0));
    bows out = {.rights = signs_d((l4)A)};
    *(f4 *)out.x = x, *(f4 *)out.y = y;
    *(f4 *)out.k0 = g0 * h0 - g0 - t0, *(f4 *)out.k1 = g0 * h1 + g1 * h0 - g1 - t1;
    *(f4 *)out.k2 = g1 * h1 + g2 * h0 - g2 - t2, *(f4 *)out.k3 = g2 * h1 - t3;
    *(f4 *)out.bulge = (f4)((i4)bulge & bent), *(f4 *)out.off = off;
    *(f4 *)out.reach = least_f(flat + N * 0x1p-22f + 0x1p-16f, 0x1p36f - zero) + size_f(y) * (0.5f * TILE);
    return out;
}

/* The spans of a strip in a bend: those that hold every sample of the triangle, and those that hold no other. Returns
 * whether the former hold any. */
INLINE int cross_bend(const bows *e, const bend *at, const rect *r, int32_t y0, spans *s, spans *sure) {
    const float middle = (float)at->half - 0.5f;
    const f8 j = __builtin_convertvector(y0 - at->y + *(const i8 *)LANE, f8) - middle;
    const f8 start = eight((float)(r->x0 - at->x) - 0.5f), end = eight((float)(r->x1 - at->x) + 0.5f);
    f8 first = start, last = end, X[3];
    for (int k = 0; k < 3; k++) {
        const f8 bulge = eight(e->bulge[k]), straight = fused(j, eight(e->y[k]), eight(e->x[k] + middle));
        const f8 k0 = eight(e->k0[k]), k1 = eight(e->k1[k]), k2 = eight(e->k2[k]), k3 = eight(e->k3[k]);
        const f8 curve = fused(j, fused(j, fused(j, k3, k2), k1), k0);
        X[k] = straight + most_of(least_of(curve, bulge), -bulge);
        if (e->rights >> k & 1) last = least_of(last, X[k] + e->off[k]);
        else first = most_of(first, X[k] - e->off[k]);
    }
    first = up(least_of(first, end + 1.0f)), last = down(most_of(last, start - 1.0f));
    const i8 left = __builtin_convertvector(first, i8), right = __builtin_convertvector(last, i8);
    if (!keep_spans(s, at->x + left, at->x + right, r, y0)) return 0;
    f8 first_sure = start, last_sure = end;
    for (int k = 0; k < 3; k++)
        if (e->rights >> k & 1) last_sure = least_of(last_sure, X[k] - e->off[k]);
        else first_sure = most_of(first_sure, X[k] + e->off[k]);
    first_sure = up(least_of(first_sure, end + 1.0f)), last_sure = down(most_of(last_sure, start - 1.0f));
    *(i8 *)sure->left = at->x + __builtin_convertvector(first_sure, i8);
    *(i8 *)sure->right = at->x + __builtin_convertvector(last_sure, i8);
    return 1;
}

/* Bounds of the samples that a triangle may cover in each of the strips from y0 on. */
INLINE spans reach_of(const bows *e, const bend *at, const rect *r, int32_t y0) {
    const f8 j = __builtin_convertvector(y0 - at->y + TILE * *(const i8 *)LANE, f8) + (0.5f * TILE - (float)at->half);
    f8 first = eight((float)(r->x0 - at->x)), last = eight((float)(r->x1 - at->x));
    const f8 beside = first - 1.0f, beyond = last + 1.0f;
    for (int k = 0; k < 3; k++) {
        const f8 X = (e->x[k] + ((float)at->half - 0.5f)) + e->y[k] * j;
        if (e->rights >> k & 1) last = least_of(last, X + e->reach[k]);
        else first = most_of(first, X - e->reach[k]);
    }
    spans s;
    *(i8 *)s.left = at->x + __builtin_convertvector(down(least_of(first, beyond)), i8);
    *(i8 *)s.right = at->x + __builtin_convertvector(up(most_of(last, beside)), i8);
    return s;
}

INLINE d4 largest_in(const triangle *t, const cc_lens *lens, size_t tile) {
    const double *const *side = (const double *const *)lens->side;
    const double *x = side[t->a[3] > 0] + tile, *y = side[2 + (t->b[3] > 0)] + tile;
    return t->a[3] * *(const d4 *)x + (t->b[3] * *(const d4 *)y + t->c[3]);
}

/* Draw the spans of a strip: samples outside `sure` but inside `s` are in doubt. */
INLINE void draw_spans(const band *b, const triangle *t, int32_t ty, const spans *s, const spans *sure) {
    const cc_lens *lens = b->grid->lens;
    const i8 left = *(const i8 *)s->left, right = *(const i8 *)s->right;
    const i8 from = *(const i8 *)sure->left, to = *(const i8 *)sure->right;
    int32_t x0, x1;
    columns_of(left, right, &x0, &x1);
    x0 /= TILE, x1 /= TILE;
    const size_t wide = (size_t)b->grid->tiles_x, of_lens = (size_t)ty * wide;
    const float *farthest = b->sheet->farthest + (size_t)(ty - b->first_tiles) * wide;
    for (int32_t tx = x0; tx <= x1; tx += 4) {
        unsigned show = may_show(t, largest_in(t, lens, of_lens + (size_t)tx), *(const f4 *)(farthest + tx));
        if (x1 - tx < 3) show &= (2u << (x1 - tx)) - 1;
        for (; show; show &= show - 1) {
            const int32_t x = tx + __builtin_ctz(show), first = x * TILE, last = first + (TILE - 1);
            const unsigned rows = signs((left <= last) & (right >= first));
            if (!rows) continue;
            unsigned doubt = lens->partial[of_lens + (size_t)x] ? 0xFF : 0;
            doubt |= signs(((left < from) & (from > first)) | ((right > to) & (to < last)));
            VARIANT(draw_tile)(b, t, s, rows, doubt & rows, x, ty);
        }
    }
}

/* Draw the part of a triangle in a rectangle by the definition of P alone, in the tiles that it may meet. */
static __attribute__((noinline)) void draw_by_definition(const band *b, const triangle *t, const rect *r) {
    const size_t wide = (size_t)b->grid->tiles_x;
    const i8 x0 = r->x0 + (i8){0}, x1 = r->x1 + (i8){0};
    for (int32_t ty = r->y0 / TILE; ty <= r->y1 / TILE; ty++) {
        spans s;
        if (!keep_spans(&s, x0, x1, r, ty * TILE)) continue;
        const unsigned rows = signs(*(const i8 *)s.left <= *(const i8 *)s.right);
        const float *farthest = b->sheet->farthest + (size_t)(ty - b->first_tiles) * wide;
        for (int32_t tx = r->x0 / TILE; tx <= r->x1 / TILE; tx++) {
            const box area = area_of(b->grid, r, 0, tx, ty);
            if (misses(t, &area) || nearest_of(t, &area) < farthest[tx]) continue;
            VARIANT(draw_tile)(b, t, &s, rows, rows, tx, ty);
        }
    }
}

/* Draw the part of a triangle in a rectangle within a bend. */
static void draw_bent(const band *b, const triangle *t, const rect *r, const bend *at, float nearest) {
    if (extreme(t) || at->rough) {
        draw_by_definition(b, t, r);
        return;
    }
    const int32_t top = r->y0 / TILE;
    const bows e = bows_of(t, at);
    const spans reach = reach_of(&e, at, r, top * TILE);
    for (int32_t ty = top; ty <= r->y1 / TILE; ty++) {
        const int32_t x0 = imax(reach.left[ty - top], r->x0), x1 = imin(reach.right[ty - top], r->x1);
        spans s, sure;
        if (x0 > x1 || strip_hidden(b, nearest, x0, x1, ty)) continue;
        if (cross_bend(&e, at, r, ty * TILE, &s, &sure)) draw_spans(b, t, ty, &s, &sure);
    }
}

/* Descend into the blocks of the picture that the triangle meets, as far as the lens is nearly affine. */
static void draw_block(const band *b, const triangle *t, const rect *r, int level, int32_t bx, int32_t by) {
    const int shift = level + 3; /* TILE = 1 << 3 */
    const rect here = {imax(r->x0, bx << shift), imin(r->x1, ((bx + 1) << shift) - 1),
                       imax(r->y0, by << shift), imin(r->y1, ((by + 1) << shift) - 1)};
    const box area = area_of(b->grid, r, level, bx, by);
    if (misses(t, &area)) return;
    if (level <= CHUNK) {
        const bend *at = bend_at(b->grid->lens, level - CHUNK + 1, bx << shift, by << shift);
        if (level < CHUNK || !at->strong) {
            draw_bent(b, t, &here, at, nearest_of(t, &area));
            return;
        }
    }
    for (int32_t y = here.y0 >> (shift - 1); y <= here.y1 >> (shift - 1); y++)
        for (int32_t x = here.x0 >> (shift - 1); x <= here.x1 >> (shift - 1); x++) draw_block(b, t, r, level - 1, x, y);
}

void VARIANT(draw_through_lens)(const band *b, const triangle *t, const rect *r) {
    const cc_lens *lens = b->grid->lens;
    if (r->x1 - r->x0 < PATCH / 2 && r->y1 - r->y0 < PATCH / 2)
        draw_bent(b, t, r, bend_at(lens, 0, r->x0, r->y0), t->nearest);
    else if (r->x1 - r->x0 < PATCH && r->y1 - r->y0 < PATCH && !bend_at(lens, 1, r->x0, r->y0)->strong)
        draw_bent(b, t, r, bend_at(lens, 1, r->x0, r->y0), t->nearest);
    else {
        int shift = CHUNK + 3; /* samples to blocks: TILE = 1 << 3 */
        while ((r->x1 >> shift) - (r->x0 >> shift) > 1 || (r->y1 >> shift) - (r->y0 >> shift) > 1) shift++;
        for (int32_t y = r->y0 >> shift; y <= r->y1 >> shift; y++)
            for (int32_t x = r->x0 >> shift; x <= r->x1 >> shift; x++) draw_block(b, t, r, shift - 3, x, y);
    }
}
#endif
