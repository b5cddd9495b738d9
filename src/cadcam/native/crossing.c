/* Where segments cross: see crossing.h. */
#include "crossing.h"

#include <math.h>
#include <stdlib.h>

static const double SLACK = 1e-6;  /* of a cell: a segment along a cell's side is in the cells on both sides */
static const double BEHIND = 1e-6; /* relative: a border this little behind a line still cuts it */

/* n x n cells over all lines, about one per segment. Cell k touches border[first[k]] to border[first[k + 1] - 1]. */
typedef struct {
    double low[2], scale[2];
    int64_t n, *first, *border;
} grid;

/* A segment's way through the cells: column by column, from left to right, and up from the lowest row in each. */
typedef struct {
    double x0, x1, y0, slope, low, high; /* in cells: start and end; slope; range of y */
    int64_t column, last, row, top;
} way;

static int64_t between(double v, double low, double high) { return (int64_t)fmax(low, fmin(floor(v), high)); }

static way way_of(const grid *g, const cc_flat *segments, int64_t i) {
    double p[2][2];
    for (int k = 0; k < 2; k++) {
        p[0][k] = (segments->a[2 * i + k] - g->low[k]) * g->scale[k];
        p[1][k] = (segments->b[2 * i + k] - g->low[k]) * g->scale[k];
    }
    const double *l = p[p[1][0] < p[0][0]], *r = p[p[1][0] >= p[0][0]];
    double slope = (r[1] - l[1]) / (r[0] - l[0]); /* of a vertical one infinite, or NaN: then its whole range counts */
    return (way){l[0], r[0], l[1], slope, fmin(l[1], r[1]), fmax(l[1], r[1]),
                 between(l[0] - SLACK, 0, (double)g->n) - 1, between(r[0] + SLACK, -1, (double)g->n - 1), 0, -1};
}

/* Return the next cell on the way, -1 after the last. */
static int64_t next_cell(const grid *g, way *w) {
    while (w->row > w->top) {
        if (++w->column > w->last) return -1;
        double x = (double)w->column;
        double from = w->y0 + w->slope * (fmax(w->x0, x - SLACK) - w->x0);
        double to = w->y0 + w->slope * (fmin(w->x1, x + 1 + SLACK) - w->x0);
        w->row = between(fmax(w->low, fmin(from, to)) - SLACK, 0, (double)g->n);
        w->top = between(fmin(w->high, fmax(from, to)) + SLACK, -1, (double)g->n - 1);
    }
    return w->row++ * g->n + w->column;
}

/* Make the grid and put the borders into its cells; return whether memory suffices. */
static int laid(grid *g, const cc_flat *lines, const cc_flat *borders) {
    for (int k = 0; k < 2; k++) {
        double low = INFINITY, high = -INFINITY;
        for (int64_t i = 0; i < lines->n; i++) {
            low = fmin(low, fmin(lines->a[2 * i + k], lines->b[2 * i + k]));
            high = fmax(high, fmax(lines->a[2 * i + k], lines->b[2 * i + k]));
        }
        g->n = between(0.7 * sqrt((double)(lines->n + borders->n)), 8, 1024);
        g->low[k] = low, g->scale[k] = (double)g->n / fmax(high - low, 1e-12);
    }
    int64_t cells = g->n * g->n, cell;
    if (!(g->first = calloc((size_t)cells + 2, sizeof *g->first))) return 0;
    for (int64_t j = 0; j < borders->n; j++)
        for (way w = way_of(g, borders, j); (cell = next_cell(g, &w)) >= 0;) g->first[cell + 2]++;
    for (cell = 0; cell < cells; cell++) g->first[cell + 2] += g->first[cell + 1];
    if (!(g->border = malloc(((size_t)g->first[cells + 1] + 1) * sizeof *g->border))) return 0;
    for (int64_t j = 0; j < borders->n; j++)
        for (way w = way_of(g, borders, j); (cell = next_cell(g, &w)) >= 0;) g->border[g->first[cell + 1]++] = j;
    return 1;
}

/* Return the fraction of line i's image where it meets border j, if that is not behind it there; else -1. */
static double met(const cc_flat *lines, int64_t i, const cc_flat *borders, int64_t j, double slack) {
    const double *a = lines->a + 2 * i, *b = lines->b + 2 * i, *p = borders->a + 2 * j, *q = borders->b + 2 * j;
    double vx = q[0] - p[0], vy = q[1] - p[1];
    double before = vx * (a[1] - p[1]) - vy * (a[0] - p[0]), after = vx * (b[1] - p[1]) - vy * (b[0] - p[0]);
    if (!(before * after < 0)) return -1;
    double s = before / (before - after), length2 = vx * vx + vy * vy, reach = slack / sqrt(length2);
    double k = (vx * (a[0] + s * (b[0] - a[0]) - p[0]) + vy * (a[1] + s * (b[1] - a[1]) - p[1])) / length2;
    double w = lines->wa[i] + s * (lines->wb[i] - lines->wa[i]);
    double its = borders->wa[j] + k * (borders->wb[j] - borders->wa[j]);
    return k >= -reach && k <= 1 + reach && its >= w * (1 - BEHIND) ? s : -1;
}

int64_t cc_crossings(const cc_flat *lines, const cc_flat *borders, const double *slack, int64_t room, int64_t *line,
                     double *s) {
    grid g = {0};
    int64_t count = laid(&g, lines, borders) ? 0 : -1, cell;
    for (int64_t i = 0; i < lines->n && count >= 0; i++)
        for (way w = way_of(&g, lines, i); (cell = next_cell(&g, &w)) >= 0;)
            for (int64_t k = g.first[cell]; k < g.first[cell + 1]; k++) {
                double at = met(lines, i, borders, g.border[k], slack[g.border[k]]);
                if (at < 0) continue;
                if (count < room) line[count] = i, s[count] = at;
                count++;
            }
    free(g.first), free(g.border);
    return count;
}
