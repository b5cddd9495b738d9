/* Random and vicious scenes through the core, for a build with sanitizers: fuzz NUMBER [FIRST]. Scene k is the same in
 * every run, whatever came before it.
 *
 * Coordinates of every magnitude, shared, repeated and collinear corners, cameras inside the model, lenses with holes,
 * pictures down to one pixel, every channel present or not. Beyond what the sanitizers see, each picture is drawn
 * twice, with one band and with several: both must be equal, and every id in range. Then direction fields of random
 * pictures, and edges with wild places over them: poses stay rotations, scores in range. Then steps along lines in and
 * out of a picture, regressions by groups, marks at any homography, points and edges before and behind what a view
 * shows, crossings of segments, and pictures and masks of every size made files. */
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "crossing.h"
#include "field.h"
#include "grouped.h"
#include "layers.h"
#include "mark.h"
#include "pack.h"
#include "profile.h"
#include "raster.h"
#include "seen.h"

static uint64_t state;
static void start(int scene) { state = 88172645463325252ull + (uint64_t)scene * 0x9E3779B97F4A7C15ull; }
static uint64_t next(void) { /* xorshift64, Marsaglia 2003 */
    state ^= state << 13, state ^= state >> 7, state ^= state << 17;
    return state;
}
static int upto(int n) { return (int)(next() % (uint64_t)(n + 1)); }
static double unit(void) { return (double)(next() >> 11) / 9007199254740992.0; }
static double around(void) { return 2 * unit() - 1; }
static double wild(void) {
    static const double odd[] = {0, 1, -1, 1e-300, 1e300, -1e300, 1e-12, 64, 1e150};
    return upto(9) ? around() * pow(10, upto(3)) : odd[upto(8)];
}
static float wild_weight(void) { return (float)fmin(fabs(wild()), FLT_MAX); } /* finite and >= 0: as the core asks */

static void rotation(double R[9]) { /* from a random quaternion */
    double q[4], s = 0;
    for (int k = 0; k < 4; k++) q[k] = around(), s += q[k] * q[k];
    for (int k = 0; k < 4; k++) q[k] /= sqrt(s);
    double w = q[0], x = q[1], y = q[2], z = q[3];
    double r[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
                   2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                   2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)};
    memcpy(R, r, sizeof r);
}

typedef struct { float *image, *coverage, *depth, *normal; int32_t *part, *face; uint8_t *rgb; } picture;

static picture layers(size_t pixels) { /* exactly as large as they must be */
    return (picture){malloc(pixels * 12), malloc(pixels * 4), malloc(pixels * 4),
                     malloc(pixels * 12), malloc(pixels * 4), malloc(pixels * 4),
                     malloc(pixels * 3)};
}
static void release(picture *p) {
    free(p->image), free(p->coverage), free(p->depth), free(p->normal), free(p->part), free(p->face);
    free(p->rgb);
}

static void draw(const cc_scene *scene, cc_view *v, picture *p, int mask, int bands, cc_worker *worker) {
    v->bands = bands;
    v->image = mask & 1 ? p->image : NULL, v->coverage = mask & 2 ? p->coverage : NULL;
    v->rgb = mask & 64 ? p->rgb : NULL;
    v->depth = mask & 4 ? p->depth : NULL, v->normal = mask & 8 ? p->normal : NULL;
    v->part = mask & 16 ? p->part : NULL, v->face = mask & 32 ? p->face : NULL;
    cc_frame *frame = cc_frame_new(scene, v);
    if (frame) cc_frame_look(frame);
    if (!frame || cc_frame_work(frame, worker)) exit(fprintf(stderr, "out of memory\n"));
    cc_frame_free(frame);
}

static void differ(const char *what) { exit(fprintf(stderr, "%s differs between one band and several\n", what)); }

/* Where n x n samples a pixel look through a lens that bends, and may be blind in places. */
static cc_lens *lens_of(int width, int height, int n, double f, double cx, double cy, double bend, int hole,
                        int blind) {
    const int W = width * n, H = height * n;
    double *points = malloc((size_t)W * (size_t)H * 16);
    for (int y = 0; y < H; y++)
        for (int x = 0; x < W; x++) {
            double u = ((x + 0.5) / n - 0.5 - cx) / f, w = ((y + 0.5) / n - 0.5 - cy) / f;
            double g = 1 + bend * (u * u + w * w);
            int nowhere = blind || (hole && upto(4) == 0);
            points[2 * (y * W + x)] = nowhere ? NAN : u * g * (upto(500) ? 1 : 1e300);
            points[2 * (y * W + x) + 1] = w * g;
        }
    cc_lens *table = cc_lens_new(points, W, H);
    free(points);
    return table;
}

static void one(int number) {
    int n_vertices = 1 + upto(60), n_faces = 1 + upto(number % 10 ? 40 : 400), n_parts = 1 + upto(2);
    int width = 1 + upto(40), height = 1 + upto(40), samples = upto(2) ? 1 : 2 + upto(2), vicious = upto(2) == 0;
    double *vertices = malloc((size_t)n_vertices * 24);
    int32_t *faces = malloc((size_t)n_faces * 12), *part = malloc((size_t)n_faces * 4);
    float *colors = malloc((size_t)n_parts * 12);
    for (int i = 0; i < 3 * n_vertices; i++) vertices[i] = vicious ? wild() : around() * 10;
    for (int i = 0; i < 3 * n_faces; i++) faces[i] = upto(n_vertices - 1);
    for (int i = 0; i < n_faces; i++) part[i] = upto(n_parts - 1);
    for (int i = 0; i < 3 * n_parts; i++) colors[i] = (float)unit();

    cc_view v = {.width = width, .height = height, .samples = samples, .ambient = 0.2f, .head = 0.5f, .fill = 0.3f};
    double f = 1 + unit() * 100, cx = unit() * width, cy = unit() * height, R[9], t[3];
    v.fronts = upto(2) == 0;
    rotation(R);
    for (int k = 0; k < 3; k++) t[k] = around() * (upto(1) ? 0 : 20);
    int lens = upto(1);
    double fx = lens ? 1 : f, px = lens ? 0 : cx, py = lens ? 0 : cy, skew = lens ? 0 : around();
    for (int k = 0; k < 4; k++) {
        double r0 = k < 3 ? R[k] : t[0], r1 = k < 3 ? R[3 + k] : t[1], r2 = k < 3 ? R[6 + k] : t[2];
        v.plane[k] = fx * r0 + skew * r1 + px * r2, v.plane[4 + k] = fx * r1 + py * r2, v.plane[8 + k] = r2;
    }
    for (int i = 0; i < 3; i++) {
        v.ray[3 * i] = R[i] / fx, v.ray[3 * i + 1] = R[3 + i] / fx;
        v.ray[3 * i + 2] = R[6 + i] - R[i] * px / fx - R[3 + i] * py / fx;
        v.fill_from[i] = R[i], v.background[i] = 1;
    }
    memcpy(v.rotation, R, sizeof R);
    cc_lens *table = NULL, *centres = NULL;
    if (lens) {
        double bend = around() * 2;
        int hole = upto(3) == 0, blind = upto(30) == 0;
        v.lens = table = lens_of(width, height, samples, f, cx, cy, bend, hole, blind);
        v.centres = centres = samples > 1 ? lens_of(width, height, 1, f, cx, cy, bend, hole, blind) : NULL;
    }
    cc_scene *scene = cc_scene_new(vertices, faces, n_faces, part, part, colors, n_parts);
    const double eye[3] = {around(), upto(9) ? around() : vertices[1], wild()};
    uint8_t *hidden = malloc((size_t)n_vertices);
    cc_scene_hides(scene, eye, upto(1) * unit(), n_vertices, vertices, hidden);
    for (int i = 0; i < n_vertices; i++)
        if (hidden[i] > 1) exit(fprintf(stderr, "hidden is %d\n", hidden[i]));
    free(hidden);
    cc_worker *worker = cc_worker_new();
    size_t pixels = (size_t)width * (size_t)height;
    picture a = layers(pixels), b = layers(pixels);
    draw(scene, &v, &a, 127, 1, worker);
    draw(scene, &v, &b, 127, 1 + upto(7), worker);
    if (memcmp(a.face, b.face, pixels * 4)) differ("face");
    if (memcmp(a.depth, b.depth, pixels * 4)) differ("depth");
    if (memcmp(a.part, b.part, pixels * 4)) differ("part");
    for (size_t i = 0; i < pixels; i++) {
        if (a.face[i] < -1 || a.face[i] >= n_faces) exit(fprintf(stderr, "face %d out of range\n", a.face[i]));
        if ((a.face[i] < 0) != (a.depth[i] == INFINITY) && a.face[i] < 0) exit(fprintf(stderr, "depth without face\n"));
    }
    if (memcmp(a.rgb, b.rgb, pixels * 3)) differ("rgb");
    for (size_t i = 0; i < 3 * pixels; i++)
        if (a.rgb[i] != (uint8_t)(a.image[i] * 255.0f + 0.5f)) exit(fprintf(stderr, "rgb is not the image, rounded\n"));
    if (memcmp(a.coverage, b.coverage, pixels * 4)) differ("coverage");
    draw(scene, &v, &b, upto(127), 1, worker);
    release(&a), release(&b);
    cc_worker_free(worker), cc_scene_free(scene), cc_lens_free(table), cc_lens_free(centres);
    free(vertices), free(faces), free(part), free(colors);
}

static float gray(int kind) { return kind == 0 ? 0.5f : kind == 1 ? (float)unit() : (float)upto(1); }

static cc_field field_of(int width, int height) { /* every buffer exactly as large as it must be */
    const size_t n = (size_t)width * (size_t)height;
    float *picture = malloc(n * 4), *scratch = malloc(50 * ((size_t)width + 12) * 4), *moments = malloc(CC_SECTORS * 8);
    uint8_t *planes = malloc(n * CC_SECTORS);
    const int kind = upto(2);
    for (size_t i = 0; i < n; i++) picture[i] = gray(kind);
    cc_directions(picture, width, height, 0.002f, scratch, planes, moments, moments + CC_SECTORS);
    const int k = 1 + upto(3);
    float *small = malloc((size_t)(width / k) * (size_t)(height / k) * 4 + 1), *half = malloc(CC_SECTORS * 8);
    const int cut = upto(width - 1);
    cc_reduce(picture + cut, width, width - cut, height, k, small);
    const int wide = 1 + upto(40), high = 1 + upto(40), step = 1 + upto(8), across = (wide - 1) / step + 2;
    const int n_nodes = 2 * across * ((high - 1) / step + 2);
    float *nodes = malloc((size_t)n_nodes * 4), *straight = malloc((size_t)(wide * high) * 4);
    uint8_t *seen = malloc((size_t)(wide * high));
    for (int i = 0; i < n_nodes; i++) nodes[i] = upto(20) ? (float)(around() * 40 + 20) : upto(1) ? (float)wild() : NAN;
    cc_straighten(picture, width, height, nodes, step, wide, high, straight, seen);
    for (int i = 0; i < wide * high; i++)
        if (seen[i] > 1 || !(straight[i] >= 0 && straight[i] <= 1.0001f))
            exit(fprintf(stderr, "straightened to %g\n", straight[i]));
    free(nodes), free(straight), free(seen);
    uint8_t *halved = malloc((size_t)(width / 2) * (size_t)(height / 2) * CC_SECTORS + 1);
    cc_halve(planes, width, height, halved, half, half + CC_SECTORS);
    free(picture), free(scratch), free(small), free(half), free(halved);
    const float *variance = moments + CC_SECTORS;
    return (cc_field){.planes = planes, .mean = moments, .variance = variance, .width = width, .height = height};
}

static int is_rotation(const double R[9]) {
    double worst = 0;
    for (int i = 0; i < 9; i++) {
        const double *a = R + i / 3 * 3, *b = R + i % 3 * 3;
        worst = fmax(worst, fabs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] - (i % 4 == 0)));
        if (!isfinite(R[i])) return 0;
    }
    return worst < 1e-12;
}

static void edges(void) {
    const int n_eyes = 1 + upto(1), n_poses = 1 + upto(3), n_places = upto(60), keep = 1 + upto(2);
    cc_eye *eyes = calloc((size_t)n_eyes, sizeof *eyes);
    cc_place *places = malloc((size_t)n_places * sizeof *places + 1);
    int64_t *first = malloc((size_t)(n_eyes * n_poses) * 8);
    int32_t *count = malloc((size_t)(n_eyes * n_poses) * 4), *shift = malloc((size_t)(n_poses * keep) * 8);
    float *score = malloc((size_t)(n_poses * keep) * 4), *sure = malloc((size_t)(n_poses * (n_places + 1)) * 4);
    double *poses = malloc((size_t)n_poses * 96), *scores = malloc((size_t)(n_poses * n_eyes) * 32), freedom[36] = {0};
    const double blur[] = {3, 1, 0.7};
    for (int e = 0; e < n_eyes; e++) {
        eyes[e].field = field_of(1 + upto(40), 1 + upto(40));
        eyes[e].fx = 1 + 50 * unit(), eyes[e].fy = 1 + 50 * unit(), eyes[e].cx = 40 * unit(), eyes[e].cy = 40 * unit();
        rotation(eyes[e].rotation);
        for (int i = 0; i < 3; i++) eyes[e].translation[i] = upto(9) ? around() * 5 : wild();
    }
    for (int i = 0; i < n_places; i++)
        for (int j = 0; j < 6; j++) ((float *)&places[i])[j] = upto(20) ? (float)around() * 3 : (float)wild();
    const int vicious = upto(2) == 0;
    for (int i = 0; i < n_places; i++) places[i].weight = vicious ? wild_weight() : (float)unit();
    for (int i = 0; i < n_eyes * n_poses; i++) first[i] = upto(n_places), count[i] = upto(n_places - (int)first[i]);
    for (int k = 0; k < n_poses; k++) {
        rotation(poses + 12 * k);
        for (int i = 9; i < 12; i++) poses[12 * k + i] = around() * 10;
    }
    const int n_free = 1 + upto(5);
    for (int i = 0; i < n_free; i++) freedom[i * n_free + i] = 1;
    const cc_views v = {.eyes = eyes, .places = places, .first = first, .count = count,
                        .n_eyes = n_eyes, .n_poses = n_poses};
    for (int e = 0; e < n_eyes; e++) {
        const cc_field *f = &eyes[e].field;
        const int rx = upto(20), ry = upto(20), wide = f->width + 32;
        uint16_t *sums = malloc((size_t)(2 * rx + 16) * (size_t)(2 * ry + 1) * 2);
        const size_t plane = (size_t)(f->height + 2 * CC_MARGIN) * (size_t)(wide + 2 * CC_MARGIN);
        uint8_t *bytes = malloc(CC_SECTORS * plane + (size_t)wide * (size_t)f->height);
        cc_slide(&v, e, poses, upto(9) - 4, upto(9) - 4, rx, ry, keep, upto(3), sums, shift, score);
        cc_sweep(&v, e, poses, keep, upto(3), bytes, shift, score);
        for (int i = 0; i < 2 * n_poses * keep; i++)
            if (shift[i] < 0 || shift[i] >= (i % 2 ? f->height : f->width))
                exit(fprintf(stderr, "swept out of the field\n"));
        cc_certainties(&v, e, poses, 0.8, n_places + 1, sure);
        free(sums), free(bytes);
    }
    cc_climb(&v, poses, freedom, n_free, blur, 2, scores);
    for (int i = 0; i < 4 * n_poses * n_eyes; i++)
        if (!(scores[i] >= 0 && isfinite(scores[i]))) exit(fprintf(stderr, "score %d is %g\n", i % 4, scores[i]));
    for (int k = 0; k < n_poses; k++)
        if (!is_rotation(poses + 12 * k)) exit(fprintf(stderr, "a pose is no rotation any more\n"));
    for (int e = 0; e < n_eyes; e++) free((void *)eyes[e].field.planes), free((void *)eyes[e].field.mean);
    free(eyes), free(places), free(first), free(count), free(shift), free(score), free(sure), free(poses), free(scores);
}

static double *doubles(int n, double scale) { /* a few of them wild, or no numbers */
    double *a = malloc((size_t)n * 8 + 1);
    for (int i = 0; i < n; i++) a[i] = upto(30) ? around() * scale : upto(1) ? wild() : NAN;
    return a;
}

/* Profiles and steps at places in and out of a picture, and what lines are pulled and projected by. */
static void along_lines(void) {
    const int width = 1 + upto(60), height = 1 + upto(60), n = upto(40), most = 1 + upto(4), reach = upto(70);
    float *pixels = malloc((size_t)(width * height) * 4);
    for (int i = 0, kind = upto(2); i < width * height; i++) pixels[i] = gray(kind);
    const cc_picture picture = {pixels, width, height};
    double *q = doubles(2 * n, 70), *twins = doubles(4 * n, 8), *held = doubles(2 * n, 5);
    double *normal = malloc((size_t)n * 16 + 1), *below = malloc((size_t)n * 8 + 1), *above = malloc((size_t)n * 8 + 1);
    for (int i = 0; i < n; i++) {
        const double angle = 7 * unit();
        normal[2 * i] = cos(angle), normal[2 * i + 1] = sin(angle);
        below[i] = 30 * unit(), above[i] = 30 * unit();
        held[2 * i] = fabs(held[2 * i]), held[2 * i + 1] = fabs(held[2 * i + 1]);
    }
    double *offset = malloc((size_t)(n * most) * 8 + 1), *slope = malloc((size_t)(n * most) * 8 + 1);
    cc_candidates(&picture, n, q, normal, 8 * unit(), reach, 0.002, most, offset, slope);
    for (int i = 0; i < n * most; i++)
        if (!(isnan(offset[i]) ? isnan(slope[i]) : fabs(offset[i]) <= reach + 1))
            exit(fprintf(stderr, "offset %g\n", offset[i]));
    double *sums = malloc((size_t)(n * CC_STEP_SUMS) * 8 + 1), *steps = malloc((size_t)(n * CC_STEP_TERMS) * 8 + 1);
    cc_step_sums(&picture, n, q, normal, below, above, twins, 4 * unit(), 0.3 + 3 * unit(), 0.002, 0.998, sums);
    cc_steps(n, sums, held, steps);
    double K[9] = {100, 1, 30, 0, 90, 30, 0, 0, 1}, R[9], *p = doubles(3 * n, 9), *t = doubles(3 * n, 1), x[9];
    double *row = malloc((size_t)n * 48 + 1), *mean = malloc((size_t)n * 16 + 1), *stiff = doubles(36, 1);
    int32_t *run = malloc((size_t)n * 4 + 1);
    for (int i = 0; i < n; i++) run[i] = i / 5;
    rotation(R);
    double lens[CC_LENS];
    for (int i = 0; i < CC_LENS; i++) lens[i] = unit() - 0.5;
    cc_camera_rows(n, K, upto(1) ? lens : NULL, upto(1) ? INFINITY : unit(), R, (double[3]){0, 0, 9}, p, t, q, normal,
                   row);
    cc_along_runs(n, 2, held, run, upto(12), mean);
    for (int i = 0; i < 6; i++) x[i] = 0;
    cc_pull(n, most, 6, row, offset, slope, upto(1) ? stiff : NULL, x, 1.0, 0.3, 1e-3, 2, x);
    const int64_t lines = n ? 1 + upto(n - 1) : 0, tries = 1 + upto(3);
    int64_t *first = malloc((size_t)lines * 8 + 1);
    double *moved = doubles((int)tries * n, 20), *counts = malloc((size_t)tries * 8);
    double *share = malloc((size_t)(tries * lines) * 8 + 1);
    for (int64_t l = 0; l < lines; l++) first[l] = l;
    cc_met(n, most, offset, slope, lines, first, tries, moved, 2.0, 0.4, 6.0, counts, share);
    for (int64_t k = 0; k < tries * lines; k++)
        if (!(share[k] >= 0 && share[k] <= 1)) exit(fprintf(stderr, "share %g\n", share[k]));
    free(first), free(moved), free(counts), free(share);
    free(pixels), free(q), free(normal), free(twins), free(held), free(below), free(above), free(offset), free(slope);
    free(sums), free(steps), free(p), free(t), free(row), free(mean), free(stiff), free(run);
}

static void grouped(void) {
    const int groups = 1 + upto(12), k = 1 + upto(upto(9) ? 5 : CC_UNKNOWNS - 1);
    const int n = groups + upto(60), tried = 1 + upto(6);
    double *y = doubles(n, 1), *J = doubles(n * k, 5), *w = malloc((size_t)n * 8), *of = malloc((size_t)groups * 24);
    double *what = malloc((size_t)tried * 24), *x = malloc((size_t)k * 8), *C = malloc((size_t)(k * k) * 8);
    double *p = malloc((size_t)tried * 8);
    double *scratch = malloc((size_t)(groups * ((k + 1) * (k + 4) / 2 + 1) + tried * k * (k + 1)) * 8);
    int64_t *group = malloc((size_t)n * 8);
    for (int i = 0; i < n; i++) w[i] = unit(), group[i] = i * groups / n;
    for (int i = 0; i < 3 * groups; i++) of[i] = upto(3) ? unit() : upto(1);
    for (int i = 0; i < 3 * tried; i++) what[i] = unit();
    const cc_grouped data = {.y = y, .J = J, .w = w, .group = group,
                             .of_group = of, .free = of + groups, .expected = of + 2 * groups,
                             .variance = what, .share = what + tried, .prior = what + 2 * tried,
                             .n = n, .groups = groups, .k = k, .tried = tried};
    cc_grouped_fit(&data, scratch, x, C, p);
    free(y), free(J), free(w), free(of), free(what), free(x), free(C), free(p), free(scratch), free(group);
}

/* Marks of rings and sectors; their share of ink has no cause to leave [0, 1] but through wild homographies. */
static void marks(void) {
    const int radii = 1 + upto(5), rays = 1 + upto(7), sectors = 1 + upto(6), count = upto(3), pixels = upto(30);
    const int terms = upto(1) ? 4 : 4 + upto(CC_MARK_TERMS - 4), width = upto(1) ? 2 : 8, slopes = upto(2) > 0;
    const int loose = upto(3);
    double *r = malloc((size_t)radii * 8), *ray = malloc((size_t)rays * 16), *span = malloc((size_t)sectors * 8);
    int32_t *sector = malloc((size_t)sectors * 16);
    for (int i = 0; i < radii; i++) r[i] = (i + unit()) * 4 + 0.1;
    for (int i = 0; i < rays; i++) ray[2 * i] = cos(i + 0.3), ray[2 * i + 1] = sin(i + 0.3);
    for (int i = 0; i < sectors; i++) {
        const int whole = upto(1), from = upto(radii - 1), a = upto(rays - 1), b = upto(rays - 1);
        sector[4 * i] = upto(1) ? -1 : from, sector[4 * i + 1] = from + upto(radii - 1 - from);
        sector[4 * i + 2] = whole ? -1 : a, sector[4 * i + 3] = whole ? -1 : b;
        span[i] = whole ? 2 * acos(-1.0) : fmod(b - a + 20 * acos(-1.0), 2 * acos(-1.0));
    }
    const cc_mark mark = {r, ray, sector, span, radii, sectors};
    double *places = doubles(count * pixels * width, 30);
    double *H = doubles(count * 9, 1), *dH = doubles(count * terms * 9, 1);
    double *levels = doubles(count * 8, 1), *value = malloc((size_t)(count * pixels) * 8 + 1);
    double *slope = malloc((size_t)(count * pixels) * (size_t)(terms + 5 + loose) * 8 + 1);
    if (upto(1))
        for (int i = 0; i < 9 * count; i++) H[i] = (i % 9 % 4 == 0) + 0.01 * around();
    for (int i = 0; i < 2 * count; i++) /* more at rest than in motion, some by far more than their size */
        if (upto(2)) levels[8 * (i / 2) + 6 + i % 2] = 0;
    cc_mark_picture(&mark, count, pixels, width, places, H, terms, dH, levels, loose, value, slopes ? slope : NULL);
    free(r), free(ray), free(span), free(sector), free(places);
    free(H), free(dH), free(levels), free(value), free(slope);
}

static void seen(void) {
    const int width = 1 + upto(40), height = 1 + upto(40), n = upto(50), planes = 1 + upto(5);
    float *depth = malloc((size_t)(width * height) * 4), *normal = malloc((size_t)(width * height) * 12);
    for (int i = 0; i < width * height; i++) depth[i] = upto(3) ? (float)(9 + unit()) : INFINITY;
    for (int i = 0; i < 3 * width * height; i++) normal[i] = upto(5) ? (float)around() : upto(9) ? 0 : (float)wild();
    double *p = doubles(3 * n, 20), *q = doubles(2 * n, 50), *ends = doubles(6 * n, 12);
    int32_t *sides = malloc((size_t)n * 8 + 1), *chain = malloc((size_t)n * 4 + 1);
    uint8_t *out = malloc((size_t)n + 1), *rule = malloc((size_t)n + 1), *front = malloc((size_t)planes);
    for (int i = 0; i < n; i++) {
        sides[2 * i] = upto(planes - 1), sides[2 * i + 1] = upto(planes - 1);
        chain[i] = i / 5, rule[i] = (uint8_t)upto(2);
        if (i && upto(1)) memcpy(ends + 6 * i, ends + 6 * i - 3, 24); /* head to tail */
    }
    for (int i = 0; i < planes; i++) front[i] = (uint8_t)upto(1);
    const cc_sight sight = {depth, normal, 1 / 30.f, 1 / 30.f, 1e-3f, 0.1f, width, height};
    cc_seen(&sight, n, p, q, out);
    for (int i = 0; i < n; i++)
        if (out[i] > 1) exit(fprintf(stderr, "seen is %d\n", out[i]));
    cc_eye_point eye = {.K = {30, 1, width / 2., 0, 30, height / 2.}, .near = 1e-3};
    double R[9];
    rotation(R);
    for (int i = 0; i < 12; i++) eye.pose[i] = i % 4 < 3 ? R[i / 4 * 3 + i % 4] : i == 11 ? 9 : 0;
    const cc_edges edges = {ends, sides, chain, rule, n};
    const int64_t room = upto(3) ? 50 * n : upto(9);
    cc_lines lines = {malloc((size_t)room * 16 + 1), malloc((size_t)room * 24 + 1), malloc((size_t)room * 4 + 1),
                      malloc((size_t)room * 4 + 1), room, 0, 0};
    cc_seen_edges(&sight, &eye, &edges, front, 1, 1.5, upto(1) ? 2 * unit() : 0, &lines);
    for (int64_t i = 0; i < lines.points && lines.points <= room; i++)
        if (!(fabs(lines.q[2 * i]) < 100 && fabs(lines.q[2 * i + 1]) < 100))
            exit(fprintf(stderr, "seen beyond the picture\n"));
    for (int64_t i = 0; i < lines.lines && lines.lines <= room; i++)
        if (lines.start[i] < (i ? lines.start[i - 1] + 2 : 0))
            exit(fprintf(stderr, "a line of less than two points\n"));
    free(depth), free(normal), free(p), free(q), free(ends);
    free(sides), free(chain), free(out), free(rule), free(front);
    free(lines.q), free(lines.p), free(lines.edge), free(lines.start);
}

/* Segments anywhere, upright and level ones on the grid's own lines among them. */
static void crossing(void) {
    const int n[2] = {upto(30), upto(30)}, even = upto(1), room = upto(200);
    cc_flat flat[2];
    double *ends[4], *w[2], *slack = malloc((size_t)n[1] * 8 + 1), *s = malloc((size_t)room * 8 + 1);
    int64_t *line = malloc((size_t)room * 8 + 1);
    for (int k = 0; k < 4; k++) {
        ends[k] = doubles(2 * n[k / 2], 2);
        for (int i = 0; even && i < 2 * n[k / 2]; i++) ends[k][i] = upto(8);
    }
    for (int k = 0; k < 2; k++) {
        w[k] = malloc((size_t)n[k] * 16 + 1);
        for (int i = 0; i < 2 * n[k]; i++) w[k][i] = upto(9) ? unit() : fabs(wild());
        flat[k] = (cc_flat){ends[2 * k], ends[2 * k + 1], w[k], w[k] + n[k], n[k]};
    }
    for (int i = 0; i < n[1]; i++) slack[i] = upto(1) ? 1e-9 : unit();
    const int64_t found = cc_crossings(&flat[0], &flat[1], slack, room, line, s);
    for (int64_t i = 0; i < found && i < room; i++)
        if (line[i] < 0 || line[i] >= n[0] || !(s[i] >= 0 && s[i] <= 1))
            exit(fprintf(stderr, "crossing at %g\n", s[i]));
    for (int k = 0; k < 4; k++) free(ends[k]);
    free(w[0]), free(w[1]), free(slack), free(s), free(line);
}

/* Pictures of noise, of runs and of nothing, in and out of the room they need; masks, depths and normals as files
 * have them. */
static void files(void) {
    const int width = 1 + upto(70), height = 1 + upto(40), pixel = 1 + upto(3), kind = upto(3), n = width * height;
    uint8_t *pixels = malloc((size_t)(n * pixel)), *mask = malloc((size_t)n), *packed;
    for (int i = 0; i < n * pixel; i++)
        if (kind == 3 || (kind == 2 && upto(9) == 0)) pixels[i] = (uint8_t)upto(255);
        else pixels[i] = kind && i && upto(99) ? pixels[i - 1] : 0;
    const int64_t enough = cc_pack_room(width * pixel, height), room = upto(1) ? enough : upto((int)enough);
    packed = malloc((size_t)room + 1);
    const int64_t written = cc_pack(pixels, width * pixel, height, pixel, packed, room);
    if (written > room || (room == enough && written < 0)) exit(fprintf(stderr, "packed into %d\n", (int)written));
    float *depth = malloc((size_t)n * 4), *normal = malloc((size_t)n * 12);
    for (int i = 0; i < n; i++) mask[i] = (uint8_t)(upto(kind * 5) == 0);
    for (int i = 0; i < n; i++) depth[i] = upto(2) ? INFINITY : upto(9) ? (float)(unit() * 9) : (float)wild();
    for (int i = 0; i < 3 * n; i++) normal[i] = upto(20) ? (float)around() : upto(1) ? (float)wild() : NAN;
    cc_pack_depth(depth, width, height, 0.001f, packed, room);
    cc_pack_normals(depth, normal, width, height, packed, room);
    const int some = upto(n);
    int64_t found[5], *first = malloc(((size_t)width + 1) * 8), *at = malloc((size_t)some * 8 + 1), last = -1;
    cc_mask_region(mask, width, height, found);
    if (found[0] < 0 || found[0] > n || found[3] >= width || found[4] >= height) exit(fprintf(stderr, "no region\n"));
    const int64_t changes = cc_mask_changes(mask, width, height, first, some, at);
    for (int64_t i = 0; i < changes && changes <= some; last = at[i++])
        if (at[i] <= last || at[i] >= n) exit(fprintf(stderr, "changes out of order\n"));
    free(pixels), free(mask), free(packed), free(depth), free(normal), free(first), free(at);
}

int main(int argc, char **argv) {
    const int n = argc > 1 ? atoi(argv[1]) : 100, first = argc > 2 ? atoi(argv[2]) : 0;
    for (int i = first; i < first + n; i++) {
        start(i);
        one(i), edges(), along_lines(), grouped(), marks(), seen(), crossing(), files();
    }
    printf("%d scenes drawn with %s\n", n, cc_variant());
    return 0;
}
