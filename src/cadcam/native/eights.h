/* Eight places on edges at a time, a number of each in a vector: their images in one eye, and the field beside them.
 *
 * In single precision, so places are taken relative to a pivot among them: what is far from the part's origin keeps its
 * digits. */
#ifndef CADCAM_EIGHTS_H
#define CADCAM_EIGHTS_H

#include "place.h"
#include "vectors.h"

#define TAPS 16 /* most places beside a line, to either side */

typedef struct {
    f8 p[3], tangent[3], weight; /* p from the pivot */
    i8 there;                    /* a mask: the last eight may be filled up */
} eight_places;

/* The places of a pose in one eye. */
typedef struct { const cc_place *places; int32_t count; } run;

static inline run run_of(const cc_pose_edges *v, int64_t k, int32_t eye) {
    return (run){v->places + v->first[k * v->n_eyes + eye], v->count[k * v->n_eyes + eye]};
}

/* An eye, and a part before it: camera_from_part of places that are relative to the pivot. */
typedef struct {
    float R[9], t[3], fx, skew, cx, fy, cy;
    const cc_field *field;
} view;

/* The images of eight places: pixel, unit normal of the line there, its length in the picture (that of a tangent), 1/z,
 * (x/z, y/z) and the sector. Those that count have their mask set, the others are all 0. */
typedef struct {
    f8 x, y, nx, ny, length, over_z, u, v;
    i8 sector, there;
} eight_spots;

/* The planes of their sectors: all planes together may be longer than 32 bits can number. */
typedef struct { const uint8_t *of[8]; } eight_planes;

/* The first eight places of `left`, at least 1. */
INLINE eight_places eight_of(const cc_place *places, int32_t left, const float *pivot) {
    const float *p[8], *tangent[8];
    f8 at[4], along[4]; /* x y z and a number that is not asked for; x y z weight */
    for (int k = 0; k < 8; k++) p[k] = places[imin(k, left - 1)].p, tangent[k] = places[imin(k, left - 1)].tangent;
    transposed(p, at), transposed(tangent, along);
    return (eight_places){.p = {at[0] - pivot[0], at[1] - pivot[1], at[2] - pivot[2]},
                          .tangent = {along[0], along[1], along[2]},
                          .weight = along[3],
                          .there = *(const i8 *)LANE < left};
}

static inline view view_of(const cc_eye *e, const double *pose, const float *pivot) {
    const rigid c = seen_by(e, pose);
    view v = {.fx = (float)e->fx, .skew = (float)e->skew, .cx = (float)e->cx, .fy = (float)e->fy, .cy = (float)e->cy};
    v.field = &e->field;
    for (int i = 0; i < 9; i++) v.R[i] = (float)c.R[i];
    for (int i = 0; i < 3; i++) {
        const double *r = c.R + 3 * i;
        v.t[i] = (float)(r[0] * pivot[0] + r[1] * pivot[1] + r[2] * pivot[2] + c.t[i]);
    }
    return v;
}

INLINE f8 only(i8 mask, f8 v) { return (f8)((i8)v & mask); }

INLINE i8 pick(i8 mask, int32_t yes, int32_t no) { return (mask & yes) | (~mask & no); }

/* As sector_of of place.h. */
INLINE i8 sectors_of(f8 dx, f8 dy) {
    const f8 c = dy * dy - dx * dx, s = -2 * dx * dy, a = size_of(c), b = size_of(s);
    const i8 level = b < 0.41421356f * a, upright = a < 0.41421356f * b, right = c > 0.0f, up = s > 0.0f;
    const i8 oblique = (right & pick(up, 1, 7)) | (~right & pick(up, 3, 5));
    return (level & pick(right, 0, 4)) | (~level & ((upright & pick(up, 2, 6)) | (~upright & oblique)));
}

INLINE f8 turned_by(const float *r, const f8 *v) { return r[0] * v[0] + r[1] * v[1] + r[2] * v[2]; }

/* As image_of of place.h, of the places that are at most `beside` px outside of the picture. */
INLINE eight_spots images_of(const view *w, const eight_places *e, float beside) {
    const float *R = w->R;
    const f8 X = turned_by(R, e->p) + w->t[0], Y = turned_by(R + 3, e->p) + w->t[1];
    const f8 Z = turned_by(R + 6, e->p) + w->t[2];
    const f8 tx = turned_by(R, e->tangent), ty = turned_by(R + 3, e->tangent), tz = turned_by(R + 6, e->tangent);
    const f8 k = 1 / Z, u = X * k, v = Y * k, du = tx - u * tz, dv = ty - v * tz;
    const f8 x = w->fx * u + w->skew * v + w->cx, y = w->fy * v + w->cy;
    const f8 dx = w->fx * du + w->skew * dv, dy = w->fy * dv, length = root(dx * dx + dy * dy);
    const f8 nx = -dy / (length + 1e-12f), ny = dx / (length + 1e-12f);
    const float least = -0.5f - beside, right = (float)w->field->width - 0.5f + beside;
    const float low = (float)w->field->height - 0.5f + beside;
    const i8 there = e->there & (Z > (float)NEAREST * (size_of(X) + size_of(Y))) & (x >= least) & (y >= least) &
                     (x < right) & (y < low) & (length < 1e18f);
    return (eight_spots){only(there, x), only(there, y), only(there, nx), only(there, ny), only(there, length),
                         only(there, k), only(there, u), only(there, v), sectors_of(dx, dy) & there, there};
}

INLINE eight_planes planes_of(const cc_field *f, const eight_spots *s) {
    eight_planes planes;
    const size_t size = (size_t)f->width * (size_t)f->height;
    for (int k = 0; k < 8; k++) planes.of[k] = f->planes + (size_t)s->sector[k] * size;
    return planes;
}

/* Rounded to the nearest whole number, halves up, for |v| < 2^23. */
INLINE i8 nearest_to(f8 v) {
    const f8 up = v + 0.5f;
    const i8 whole = __builtin_convertvector(up, i8);
    return whole + (__builtin_convertvector(whole, f8) > up); /* below 0 it was rounded up */
}

/* The certainties `o` px along the normals of spots, 0 outside of the picture. */
INLINE f8 certainties(const cc_field *f, const eight_planes *planes, const eight_spots *s, int o) {
    const i8 column = nearest_to(s->x + (float)o * s->nx), row = nearest_to(s->y + (float)o * s->ny);
    const i8 there = s->there & (column >= 0) & (column < f->width) & (row >= 0) & (row < f->height);
    const i8 at = (row * f->width + column) & there;
    return __builtin_convertvector(bytes_at(planes->of, at) & there, f8);
}

#endif
