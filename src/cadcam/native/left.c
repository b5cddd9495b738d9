/* What a map leaves of the table of a lens: patch.c's bounds, measured on every point, which is most of the work of
 * making a table. Compiled once for each instruction set, with the same numbers. */
#include "hot.h"

/* Numbers of a row of samples: what an expansion has there, c[0] + c[1] i + c[2] i i + c[3] i i i. */
typedef struct { double c[4]; } row;

static row row_of(const expansion *of, double j) {
    const double *map = of->map, *q = of->curves.q, *t = of->curves.t;
    const double level = map[0] + j * (map[2] + j * (q[2] + j * t[3]));
    return (row){{level, map[1] + j * (q[1] + j * t[2]), q[0] + j * t[1], t[0]}};
}

/* With `bent` known when it is compiled: half of the maps are straight, and need a third of the operations. Tile by
 * tile, as they lie in memory: whole rows would wait for it. Unrolled, GCC does not vectorise the innermost loop. */
INLINE range left_in(const cc_lens *l, const rect *r, int k, const expansion *of, int bent) {
    row rows[2 * PATCH]; /* a bend is not higher */
    double low[TILE], high[TILE];
    for (int32_t y = r->y0; y <= r->y1; y++) rows[y - r->y0] = row_of(of, y - of->y0);
    for (int m = 0; m < TILE; m++) low[m] = INFINITY, high[m] = -INFINITY;
    for (int32_t top = r->y0; top <= r->y1; top += TILE)
        for (int32_t x = r->x0; x <= r->x1; x += TILE) {
            const double at = x - of->x0, *p = l->points + point_of(top / TILE * l->tiles_x + x / TILE, 0) + k * TILE;
            const int32_t end = imin(top + TILE, r->y1 + 1);
            for (int32_t y = top; y < end; y++, p += 2 * TILE) {
                const double *c = rows[y - r->y0].c;
#pragma GCC unroll 1
                for (int m = 0; m < TILE; m++) { /* NaN changes neither bound */
                    const double i = at + COUNT[m];
                    const double left = p[m] - (c[0] + i * (bent ? c[1] + i * (c[2] + i * c[3]) : c[1]));
                    low[m] = left < low[m] ? left : low[m], high[m] = left > high[m] ? left : high[m];
                }
            }
        }
    range all = {INFINITY, -INFINITY};
    for (int m = 0; m < TILE; m++) all.low = lower(low[m], all.low), all.high = upper(high[m], all.high);
    return all;
}

range VARIANT(left_by)(const cc_lens *l, const rect *r, int k, const expansion *of) {
    return of->bent ? left_in(l, r, k, of, 1) : left_in(l, r, k, of, 0);
}
