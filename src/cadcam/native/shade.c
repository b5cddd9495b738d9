/* From the face and 1/z of each sample to the outputs: shading is deferred, so hidden samples cost none. */
#include "hot.h"
#include "vectors.h"

/* What the shading of one output needs, in float: the direction of plane points and the light, in the world. */
typedef struct { float d[9], rotation[9], fill[3], back[3], ambient, head; } light; /* fill, back: times their strength */

typedef struct { f8 x, y, z; } triple;

/* What eight samples of a row met: unit normals in the world, and colours, the background's where there is nothing. */
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
INLINE triple directions(const cc_frame *f, const light *l, int32_t tx, int32_t y) {
    const cc_lens *lens = f->view->lens;
    f8 px = __builtin_convertvector(tx * TILE + *(const i8 *)LANE, f8), py = eight((float)y);
    if (lens) {
        const size_t tile = (size_t)(y / TILE) * (size_t)f->tiles_x + (size_t)tx;
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

/* Row y of a tile: its samples see one surface, or each its own if that is NULL. */
INLINE void write_row(const cc_frame *f, const light *l, int32_t tx, int32_t y, const float *w, const int32_t *id,
                      const met *uniform) {
    const cc_view *v = f->view;
    const size_t n = (size_t)imin(TILE, f->width - tx * TILE), at = (size_t)y * (size_t)f->width + (size_t)tx * TILE;
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
    const triple d = directions(f, l, tx, y);
    if (v->image || v->rgb) {
        const triple color = shaded(l, &m, d, none);
        if (v->image) put_triples(v->image + 3 * at, color, n);
        if (v->rgb) put_bytes(v->rgb + 3 * at, color, n);
    }
    if (v->normal) put_triples(v->normal + 3 * at, facing(l, &m, d, none), n);
}

static void write_tile(const cc_frame *f, const light *l, int32_t tx, int32_t y0, int32_t rows, const float *w,
                       const int32_t *id) {
    i8 other = {0};
    for (int k = 0; k < TILE_AREA; k += TILE) other |= *(const i8 *)(id + k) != id[0];
    if (signs(other)) {
        for (int32_t r = 0; r < rows; r++) write_row(f, l, tx, y0 + r, w + r * TILE, id + r * TILE, NULL);
        return;
    }
    const met m = met_by_all(f, id[0]);
    for (int32_t r = 0; r < rows; r++) write_row(f, l, tx, y0 + r, w + r * TILE, id + r * TILE, &m);
}

/* Add a row of samples to the sums (r, g, b, covered) of an output row. */
static void add_row(const cc_frame *f, const light *l, int32_t y, const int32_t *ids, float *sums) {
    for (int32_t tx = 0; tx < f->tiles_x; tx++) {
        const int32_t *id = ids + (size_t)tx * TILE_AREA;
        const met m = met_by(f, id);
        const triple rgb = shaded(l, &m, directions(f, l, tx, y), nothing(id));
        for (int i = 0; i < imin(TILE, f->width - tx * TILE); i++) {
            float *sum = sums + 4 * (size_t)((tx * TILE + i) / f->view->samples);
            sum[0] += rgb.x[i], sum[1] += rgb.y[i], sum[2] += rgb.z[i];
            sum[3] += id[i] < 0 ? 0.0f : 1.0f;
        }
    }
}

static void write_sums(const cc_view *v, int32_t row, const float *sums) {
    const float scale = 1.0f / (float)(v->samples * v->samples);
    for (int32_t x = 0; x < v->width; x++) {
        const size_t at = (size_t)row * (size_t)v->width + (size_t)x;
        for (int k = 0; k < 3; k++) {
            const float c = sums[4 * (size_t)x + (size_t)k] * scale;
            if (v->image) v->image[3 * at + (size_t)k] = c;
            if (v->rgb) v->rgb[3 * at + (size_t)k] = (uint8_t)(c * 255.0f + 0.5f);
        }
        if (v->coverage) v->coverage[at] = sums[4 * (size_t)x + 3] * scale;
    }
}

static light light_of(const cc_view *v) {
    light l = {.ambient = v->ambient, .head = v->head};
    for (int k = 0; k < 9; k++) l.d[k] = (float)v->ray[k], l.rotation[k] = (float)v->rotation[k];
    for (int k = 0; k < 3; k++) l.fill[k] = v->fill * (float)v->fill_from[k], l.back[k] = v->back * (float)v->back_from[k];
    return l;
}

void VARIANT(write_band)(const band *b) {
    const cc_frame *f = b->frame;
    const light l = light_of(f->view);
    float *sums = b->worker->row;
    const int n = f->view->samples;
    const size_t row = (size_t)f->tiles_x * TILE_AREA;
    const float *w = b->worker->inverse_z;
    const int32_t *id = b->worker->id;
    for (int32_t y = b->y0; n == 1 && y <= b->y1; y += TILE)
        for (int32_t tx = 0; tx < f->tiles_x; tx++, w += TILE_AREA, id += TILE_AREA)
            write_tile(f, &l, tx, y, imin(TILE, b->y1 - y + 1), w, id);
    if (n == 1) return;
    for (int32_t y = b->y0; y <= b->y1; y++) {
        if (y % n == 0) memset(sums, 0, (size_t)f->view->width * 4 * sizeof *sums);
        add_row(f, &l, y, id + (size_t)(y / TILE - b->first_tiles) * row + (size_t)(y % TILE) * TILE, sums);
        if (y % n == n - 1) write_sums(f->view, y / n, sums);
    }
}
