/* Random and vicious scenes through the core, for a build with sanitizers: fuzz NUMBER [FIRST]. Scene k is the same in
 * every run, whatever came before it.
 *
 * Coordinates of every magnitude, shared, repeated and collinear corners, cameras inside the model, lenses with holes,
 * pictures down to one pixel, every channel present or not. Beyond what the sanitizers see, each picture is drawn
 * twice, with one band and with several: both must be equal, and every id in range. Then direction fields of random
 * pictures, and edges with wild places over them: poses stay rotations, scores in range. Then what stands in
 * fuzz_lines.c. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "field.h"
#include "fuzz_chance.h"
#include "raster.h"

void lines_and_files(void); /* fuzz_lines.c */

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
    float *score = malloc((size_t)(n_poses * keep) * 4);
    const cc_belief belief = {0.15, 4, 4, 0.9};
    int32_t *line = malloc((size_t)n_places * 4);
    double *share = malloc((size_t)n_poses * 8), *nats = malloc((size_t)n_poses * 8);
    double *gains = malloc((size_t)n_places * 8);
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
    for (int i = 0; i < n_places; i++) line[i] = upto(n_places - 1);
    for (int k = 0; k < n_poses; k++) share[k] = unit();
    const int vicious = upto(2) == 0;
    for (int i = 0; i < n_places; i++) places[i].weight = vicious ? wild_weight() : (float)unit();
    for (int i = 0; i < n_eyes * n_poses; i++) first[i] = upto(n_places), count[i] = upto(n_places - (int)first[i]);
    for (int k = 0; k < n_poses; k++) {
        rotation(poses + 12 * k);
        for (int i = 9; i < 12; i++) poses[12 * k + i] = around() * 10;
    }
    const int n_free = 1 + upto(5);
    for (int i = 0; i < n_free; i++) freedom[i * n_free + i] = 1;
    const cc_pose_edges v = {.eyes = eyes, .places = places, .first = first, .count = count,
                        .n_eyes = n_eyes, .n_poses = n_poses};
    for (int e = 0; e < n_eyes; e++) {
        const cc_field *f = &eyes[e].field;
        const int rx = upto(20), ry = upto(20), wide = f->width + 32;
        uint16_t *sums = malloc((size_t)(2 * rx + 16) * (size_t)(2 * ry + 1) * 2);
        const size_t plane = (size_t)(f->height + 2 * CC_MARGIN + CC_SPARE) * (size_t)(wide + 2 * CC_MARGIN);
        uint8_t *bytes = malloc(CC_SECTORS * plane + (size_t)wide * (size_t)(f->height + CC_SPARE));
        cc_slide(&v, e, poses, upto(9) - 4, upto(9) - 4, rx, ry, keep, upto(3), sums, shift, score);
        cc_sweep(&v, e, poses, keep, upto(3), bytes, shift, score);
        for (int i = 0; i < 2 * n_poses * keep; i++)
            if (shift[i] < 0 || shift[i] >= (i % 2 ? f->height : f->width))
                exit(fprintf(stderr, "swept out of the field\n"));
        cc_evidence(&v, e, poses, 0.8, line, share, &belief, gains, nats);
        for (int i = 0; i < n_poses; i++)
            if (!isfinite(nats[i])) exit(fprintf(stderr, "the evidence is %g\n", nats[i]));
        free(sums), free(bytes);
    }
    cc_climb(&v, poses, freedom, n_free, upto(1) ? unit() : 0, blur, 2, scores);
    for (int i = 0; i < 4 * n_poses * n_eyes; i++)
        if (!(scores[i] >= 0 && isfinite(scores[i]))) exit(fprintf(stderr, "score %d is %g\n", i % 4, scores[i]));
    for (int k = 0; k < n_poses; k++)
        if (!is_rotation(poses + 12 * k)) exit(fprintf(stderr, "a pose is no rotation any more\n"));
    for (int e = 0; e < n_eyes; e++) free((void *)eyes[e].field.planes), free((void *)eyes[e].field.mean);
    free(eyes), free(places), free(first), free(count), free(shift), free(score), free(poses), free(scores);
    free(line), free(share), free(nats), free(gains);
}

/* Which of many poses are kept: in their order, each once, and as many as are asked for at most. */
static void firsts(void) {
    const int n = upto(40), most = upto(n);
    double *corners = doubles(12 * n, 5);
    uint8_t *scratch = malloc((size_t)n + 1);
    int64_t *kept = malloc((size_t)most * 8 + 1);
    const int64_t found = cc_firsts(corners, n, most, 3 * unit(), scratch, kept);
    for (int64_t k = 0; k < found; k++)
        if (found > most || kept[k] >= n || kept[k] < (k ? kept[k - 1] + 1 : 0)) exit(fprintf(stderr, "kept twice\n"));
    free(corners), free(scratch), free(kept);
}

int main(int argc, char **argv) {
    const int n = argc > 1 ? atoi(argv[1]) : 100, first = argc > 2 ? atoi(argv[2]) : 0;
    for (int i = first; i < first + n; i++) {
        start(i);
        one(i), edges(), firsts(), lines_and_files();
    }
    printf("%d scenes drawn with %s\n", n, cc_variant());
    return 0;
}
