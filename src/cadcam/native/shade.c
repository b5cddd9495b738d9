/* From the face and 1/z of each sample to the outputs: shading is deferred, so hidden samples cost none. */
#include "hot.h"
#include "vectors.h"

/* What the shading of one output needs, in float: the direction of plane points and the light, in the world. */
typedef struct { float d[9], rotation[9], fill[3], back[3], ambient, head; } light; /* fill, back: times strength */

typedef struct { f8 x, y, z; } triple;

/* What eight samples of a row show: unit normals in the world, and colours, the background's where there is nothing. */
typedef struct { triple normal, color; } met;

INLINE triple same(const float v[3]) { return (triple){eight(v[0]), eight(v[1]), eight(v[2])}; }
INLINE f8 dot(triple a, const float b[3]) { return a.x * b[0] + a.y * b[1] + a.z * b[2]; }
INLINE i8 nothing(const int32_t *id) { return *(const i8 *)id < 0; }

INLINE met met_by_all(const cc_frame *f, int32_t id) {
    const surface *s = &f->scene->surfaces[id < 0 ? 0 : id];
    return (met){same(s->normal), same(id < 0 ? f->view->background : f->scene->color[s->paint])};
}

static met met_by_each(const cc_frame *f, const int32_t id[TILE]) {
    const float *record[TILE], *colors[TILE];
    f8 n[4], c[4];
    for (int i = 0; i < TILE; i++) {
        const surface *s = &f->scene->surfaces[id[i] < 0 ? 0 : id[i]];
        record[i] = s->normal; /* the colour's number comes fourth, and is not used here */
        colors[i] = f->scene->color[s->paint];
    }
    transposed(record, n), transposed(colors, c);
    const float *behind = f->view->background;
    const i8 none = nothing(id);
    for (int k = 0; k < 3; k++) c[k] = choose(none, eight(behind[k]), c[k]);
    return (met){{n[0], n[1], n[2]}, {c[0], c[1], c[2]}};
}

INLINE met met_by(const cc_frame *f, const int32_t id[TILE]) {
    const i8 other = *(const i8 *)id != id[0];
    return signs(other) ? met_by_each(f, id) : met_by_all(f, id[0]);
}

/* Directions in the world, not of unit length, in which eight samples of row y look. */
INLINE triple directions(const grid *g, const light *l, int32_t tx, int32_t y) {
    const cc_lens *lens = g->lens;
    f8 px = __builtin_convertvector(tx * TILE + *(const i8 *)LANE, f8), py = eight((float)y);
    if (lens) {
        const size_t tile = (size_t)(y / TILE) * (size_t)g->tiles_x + (size_t)tx;
        const double *at = lens->points + point_of((int32_t)tile, y % TILE * TILE);
        px = floats(*(const d4 *)(at), *(const d4 *)(at + 4));
        py = floats(*(const d4 *)(at + TILE), *(const d4 *)(at + TILE + 4));
    }
    const float *d = l->d;
    return (triple){d[0] * px + (d[1] * py + d[2]), d[3] * px + (d[4] * py + d[5]), d[6] * px + (d[7] * py + d[8])};
}

/* n . d: positive where the back of a face is seen. */
INLINE f8 along(triple n, triple d) { return n.x * d.x + n.y * d.y + n.z * d.z; }

/* Matt, two-sided: ambient, a light at the camera, two distant ones. */
INLINE triple shaded(const light *l, const met *m, triple d, i8 none) {
    const f8 cosine = along(m->normal, d), zero = {0}, one = eight(1);
    const i8 flip = ~(i8)cosine & INT32_MIN; /* signs, but for n . d < 0: the side that faces the camera */
    const f8 fill = (f8)((i8)dot(m->normal, l->fill) ^ flip), back = (f8)((i8)dot(m->normal, l->back) ^ flip);
    const f8 ahead = size_of(cosine) / root(along(d, d));
    f8 value = l->ambient + l->head * ahead + most_of(fill, zero) + most_of(back, zero);
    value = choose(none, one, value);
    const triple c = {m->color.x * value, m->color.y * value, m->color.z * value};
    return (triple){least_of(c.x, one), least_of(c.y, one), least_of(c.z, one)};
}

/* Unit normals in the camera frame, turned towards the camera. */
INLINE triple facing(const light *l, const met *m, triple d, i8 none) {
    const float *R = l->rotation;
    const i8 turned = (along(m->normal, d) > 0) & INT32_MIN;
    const f8 x = dot(m->normal, R), y = dot(m->normal, R + 3), z = dot(m->normal, R + 6);
    return (triple){(f8)(((i8)x ^ turned) & ~none), (f8)(((i8)y ^ turned) & ~none), (f8)(((i8)z ^ turned) & ~none)};
}

/* Copy the first n of eight items; a constant size is a few instructions, a variable one a call. */
INLINE void put(void *to, const void *from, size_t n, size_t size) {
    if (n == TILE) memcpy(to, from, TILE * size);
    else memcpy(to, from, n * size);
}

INLINE void put_triples(float *to, triple v, size_t n) {
    f8 out[3];
    interleaved(v.x, v.y, v.z, out);
    put(to, out, n, 3 * sizeof(float));
}

INLINE i8 byte(f8 v) { return __builtin_convertvector(v * 255.0f + 0.5f, i8); }

INLINE void put_bytes(uint8_t *to, triple v, size_t n) {
    const i8 packed = byte(v.x) | byte(v.y) << 8 | byte(v.z) << 16;
    uint8_t some[3 * TILE];
    if (n == TILE) three_bytes(packed, to);
    else three_bytes(packed, some), memcpy(to, some, 3 * n);
}

static void put_parts(const cc_frame *f, const int32_t *id, size_t at, size_t n) {
    for (size_t i = 0; i < n; i++) f->view->part[at + i] = id[i] < 0 ? -1 : f->scene->part[id[i]];
}

/* Where a band's outputs go: those that its grid does not have are NULL. */
typedef struct {
    const band *band;
    cc_view view;
    light light;
} page;

/* Row y of a tile: its samples see one surface, or each its own if that is NULL. */
INLINE void write_row(const page *p, int32_t tx, int32_t y, const float *w, const int32_t *id, const met *uniform) {
    const cc_view *v = &p->view;
    const cc_frame *f = p->band->frame;
    const size_t n = (size_t)imin(TILE, v->width - tx * TILE), at = (size_t)y * (size_t)v->width + (size_t)tx * TILE;
    const i8 none = nothing(id);
    if (v->depth) {
        const f8 z = choose(none, eight(INFINITY), 1.0f / *(const f8 *)w);
        put(v->depth + at, &z, n, sizeof(float));
    }
    if (v->face) put(v->face + at, id, n, sizeof *id);
    if (v->part) put_parts(f, id, at, n);
    if (v->coverage) {
        const f8 seen = choose(none, eight(0), eight(1));
        put(v->coverage + at, &seen, n, sizeof(float));
    }
    if (!v->image && !v->rgb && !v->normal) return;
    const met m = uniform ? *uniform : met_by(f, id);
    const triple d = directions(p->band->grid, &p->light, tx, y);
    if (v->image || v->rgb) {
        const triple color = shaded(&p->light, &m, d, none);
        if (v->image) put_triples(v->image + 3 * at, color, n);
        if (v->rgb) put_bytes(v->rgb + 3 * at, color, n);
    }
    if (v->normal) put_triples(v->normal + 3 * at, facing(&p->light, &m, d, none), n);
}

static void write_tile(const page *p, int32_t tx, int32_t y0, int32_t rows, const float *w, const int32_t *id) {
    i8 other = {0};
    for (int k = 0; k < TILE_AREA; k += TILE) other |= *(const i8 *)(id + k) != id[0];
    if (signs(other)) {
        for (int32_t r = 0; r < rows; r++) write_row(p, tx, y0 + r, w + r * TILE, id + r * TILE, NULL);
        return;
    }
    const met m = met_by_all(p->band->frame, id[0]);
    for (int32_t r = 0; r < rows; r++) write_row(p, tx, y0 + r, w + r * TILE, id + r * TILE, &m);
}

/* Write background into pixels x0 to x1 (exclusive) of a row. */
static void write_nothing(const cc_view *v, int32_t y, int32_t x0, int32_t x1) {
    const size_t at = (size_t)y * (size_t)v->width + (size_t)x0, n = (size_t)imax(x1 - x0, 0);
    float color[3];
    for (int k = 0; k < 3; k++) color[k] = v->background[k] < 1 ? v->background[k] : 1;
    if (v->normal) memset(v->normal + 3 * at, 0, 3 * n * sizeof(float));
    if (v->coverage) memset(v->coverage + at, 0, n * sizeof(float));
    if (v->part) memset(v->part + at, 0xFF, n * sizeof(int32_t));
    if (v->face) memset(v->face + at, 0xFF, n * sizeof(int32_t));
    for (size_t i = 0; v->depth && i < n; i++) v->depth[at + i] = INFINITY;
    for (size_t i = 0; v->image && i < n; i++) memcpy(v->image + 3 * (at + i), color, sizeof color);
    if (!v->rgb) return;
    uint8_t *rgb = v->rgb + 3 * at, some[3 * TILE];
    put_bytes(some, same(color), TILE);
    size_t i = 0;
    for (; i + TILE <= n; i += TILE) memcpy(rgb + 3 * i, some, sizeof some); /* of a size that compilers know */
    memcpy(rgb + 3 * i, some, 3 * (n - i));
}

/* Clear the tiles of a rectangle of them that nothing was drawn into. */
static void clear_between(const band *b, rect tiles) {
    for (int32_t y = tiles.y0; y <= tiles.y1; y++)
        for (int32_t x = tiles.x0; x <= tiles.x1; x++) {
            const size_t tile = (size_t)(y - b->first_tiles) * (size_t)b->grid->tiles_x + (size_t)x;
            if (b->sheet->changes[tile] == UNTOUCHED) clear_tile(b, tile);
        }
}

/* Rows `first` to `last` of tiles, from the leftmost tile that anything was drawn into to the rightmost; empty where
 * there is none. */
static rect drawn_in(const band *b, int32_t first, int32_t last) {
    const int32_t wide = b->grid->tiles_x;
    rect r = {wide, -1, first, last};
    for (int32_t y = first; y <= last; y++) {
        const uint8_t *changes = b->sheet->changes + (size_t)(y - b->first_tiles) * (size_t)wide;
        int32_t x0 = 0, x1 = wide - 1;
        while (x0 < r.x0 && changes[x0] == UNTOUCHED) x0++;
        while (x1 > r.x1 && changes[x1] == UNTOUCHED) x1--;
        r.x0 = imin(r.x0, x0), r.x1 = imax(r.x1, x1);
    }
    return r;
}

/* One sample a pixel: tile by tile. */
static void write_centres(const page *p) {
    const band *b = p->band;
    const sheet *s = b->sheet;
    for (int32_t y = b->y0; y <= b->y1; y += TILE) {
        const rect drawn = drawn_in(b, y / TILE, y / TILE);
        const int32_t rows = imin(TILE, b->y1 - y + 1);
        clear_between(b, drawn);
        for (int32_t r = 0; r < rows; r++) {
            write_nothing(&p->view, y + r, 0, imin(drawn.x0 * TILE, p->view.width));
            const int32_t beyond = imax(drawn.x1, drawn.x0 - 1) * TILE + TILE;
            write_nothing(&p->view, y + r, imin(beyond, p->view.width), p->view.width);
        }
        for (int32_t x = drawn.x0; x <= drawn.x1; x++) {
            const size_t tile = (size_t)(y / TILE - b->first_tiles) * (size_t)b->grid->tiles_x + (size_t)x;
            write_tile(p, x, y, rows, s->inverse_z + tile * TILE_AREA, s->id + tile * TILE_AREA);
        }
    }
}

/* Red, green, blue and covered, side by side, of a row of samples or of pixels. */
typedef struct { float *of[4]; } sums;

/* Add row y of samples, its tiles x0 to x1. */
static void add_row(const page *p, int32_t y, int32_t x0, int32_t x1, const sums *to) {
    const band *b = p->band;
    const size_t row = (size_t)(y / TILE - b->first_tiles) * (size_t)b->grid->tiles_x;
    for (int32_t tx = x0; tx <= x1; tx++) {
        const int32_t *id = b->sheet->id + (row + (size_t)tx) * TILE_AREA + y % TILE * TILE;
        const i8 none = nothing(id);
        const met m = met_by(b->frame, id);
        const triple c = shaded(&p->light, &m, directions(b->grid, &p->light, tx, y), none);
        *(f8 *)(to->of[0] + tx * TILE) += c.x, *(f8 *)(to->of[1] + tx * TILE) += c.y;
        *(f8 *)(to->of[2] + tx * TILE) += c.z, *(f8 *)(to->of[3] + tx * TILE) += choose(none, eight(0), eight(1));
    }
}

/* Means over a pixel: of n sums side by side, each of n samples. */
static void take_means(const sums *from, int n, int32_t x0, int32_t x1, const sums *to) {
    const float scale = 1.0f / (float)(n * n);
    for (int k = 0; k < 4; k++) {
        const float *restrict in = from->of[k];
        float *restrict out = to->of[k];
        if (n == 2) /* the usual number: this loop vectorises */
            for (int32_t x = x0; x < x1; x++) out[x] = (in[2 * x] + in[2 * x + 1]) * scale;
        else
            for (int32_t x = x0; x < x1; x++) {
                out[x] = 0;
                for (int i = 0; i < n; i++) out[x] += in[n * x + i];
                out[x] *= scale;
            }
    }
}

static void write_means(const cc_view *v, int32_t y, int32_t x0, int32_t x1, const sums *means) {
    const triple behind = same(v->background);
    for (int32_t x = x0; x < x1; x += TILE) {
        const size_t at = (size_t)y * (size_t)v->width + (size_t)x, n = (size_t)imin(TILE, x1 - x);
        const f8 seen = *(const f8 *)(means->of[3] + x);
        const i8 none = seen == 0; /* exactly the background, as beside what was drawn */
        const triple c = {choose(none, least_of(behind.x, eight(1)), *(const f8 *)(means->of[0] + x)),
                          choose(none, least_of(behind.y, eight(1)), *(const f8 *)(means->of[1] + x)),
                          choose(none, least_of(behind.z, eight(1)), *(const f8 *)(means->of[2] + x))};
        if (v->image) put_triples(v->image + 3 * at, c, n);
        if (v->rgb) put_bytes(v->rgb + 3 * at, c, n);
        if (v->coverage) put(v->coverage + at, &seen, n, sizeof(float));
    }
}

/* n x n samples a pixel: a row of pixels at a time. */
static void write_samples(const page *p, float *room) {
    const band *b = p->band;
    const int32_t n = b->grid->n, wide = b->grid->tiles_x * TILE;
    const sums sum = {{room, room + wide, room + 2 * wide, room + 3 * wide}};
    const sums mean = {{room + 4 * wide, room + 5 * wide, room + 6 * wide, room + 7 * wide}};
    for (int32_t y = b->y0; y <= b->y1; y += n) {
        const rect drawn = drawn_in(b, y / TILE, (y + n - 1) / TILE);
        int32_t x0 = p->view.width, x1 = p->view.width;
        if (drawn.x0 <= drawn.x1) {
            x0 = drawn.x0 * TILE / n;
            x1 = imin((drawn.x1 * TILE + TILE + n - 1) / n, p->view.width);
        }
        /* the pixels at either end may have samples in tiles beside */
        const rect tiles = {x0 * n / TILE, imin((x1 * n + TILE - 1) / TILE, b->grid->tiles_x) - 1, drawn.y0, drawn.y1};
        clear_between(b, tiles);
        for (int k = 0; k < 4 && tiles.x0 <= tiles.x1; k++)
            memset(sum.of[k] + tiles.x0 * TILE, 0, (size_t)(tiles.x1 - tiles.x0 + 1) * TILE * sizeof(float));
        for (int32_t r = y; r < y + n; r++) add_row(p, r, tiles.x0, tiles.x1, &sum);
        take_means(&sum, n, x0, x1, &mean), write_means(&p->view, y / n, x0, x1, &mean);
        write_nothing(&p->view, y / n, 0, x0), write_nothing(&p->view, y / n, x1, p->view.width);
    }
}

/* The light in the coordinates of a grid's samples. */
static light light_in(const grid *g, const cc_view *v) {
    light l = {.ambient = v->ambient, .head = v->head};
    const double scale = g->lens ? 1 : g->scale, shift = g->lens ? 0 : g->shift;
    for (int k = 0; k < 9; k++) l.rotation[k] = (float)v->rotation[k];
    for (int k = 0; k < 9; k += 3) {
        const double x = v->ray[k] / scale, y = v->ray[k + 1] / scale;
        l.d[k] = (float)x, l.d[k + 1] = (float)y, l.d[k + 2] = (float)(v->ray[k + 2] - (x + y) * shift);
    }
    for (int k = 0; k < 3; k++) {
        l.fill[k] = v->fill * (float)v->fill_from[k];
        l.back[k] = v->back * (float)v->back_from[k];
    }
    return l;
}

void VARIANT(write_band)(const band *b, float *sums) {
    page p = {b, *b->frame->view, light_in(b->grid, b->frame->view)};
    if (b->grid->n > 1) p.view.depth = p.view.normal = NULL, p.view.part = p.view.face = NULL;
    if (b->grid->n < p.view.samples) p.view.image = p.view.coverage = NULL, p.view.rgb = NULL;
    if (b->grid->n == 1) write_centres(&p);
    else write_samples(&p, sums);
}
