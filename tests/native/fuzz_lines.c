/* Random and vicious tasks along lines and over pictures, the second half of each scene of fuzz.c: steps along lines in
 * and out of a picture, the room around samples, how they move, regressions by groups, marks at any homography, points
 * and edges before and behind what a view shows, crossings of segments, rays at triangles, and pictures and masks of
 * every size made files. */
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "crossing.h"
#include "fuzz_chance.h"
#include "grouped.h"
#include "layers.h"
#include "mark.h"
#include "pack.h"
#include "profile.h"
#include "rays.h"
#include "seen.h"

/* What steps leave over of the pixels of cells, and what steps beside them explain of that: never less than nothing. */
static void beside_lines(const cc_picture *picture, int n, const double *q, const double *normal, const double *below,
                         const double *above, const double *twins, double half_length, double blur,
                         const double *sums) {
    const int bins = 1 + upto(CC_BAND_BINS - 1), all = 2 * bins + 1, tries = upto(40);
    const double width = 0.1 + unit();
    double *left = malloc((size_t)(n * all) * 8 + 1), *rest = malloc((size_t)(n * bins) * 8 + 1);
    double *number = malloc((size_t)(n * bins) * 8 + 1), *variance = malloc((size_t)n * 8 + 1);
    double *known = doubles(n * CC_BAND_KNOWN, 8), *room = doubles(2 * n, 8), *tried = doubles(tries, 8);
    double *gain = malloc((size_t)(n * tries) * 8 + 1);
    cc_step_residuals(picture, n, q, normal, below, above, twins, half_length, blur, 0.998, sums, bins, width, left);
    for (int i = 0; i < n; i++) {
        memcpy(rest + i * bins, left + i * all, (size_t)bins * 8);
        memcpy(number + i * bins, left + i * all + bins, (size_t)bins * 8);
        variance[i] = left[i * all + all - 1];
        known[i * CC_BAND_KNOWN + upto(CC_BAND_KNOWN - 1)] = NAN;
    }
    memset(gain, 0, (size_t)(n * tries) * 8);
    cc_band_gains(n, bins, width, blur, rest, number, variance, known, room, tries, tried, gain);
    for (int i = 0; i < n * tries; i++)
        if (gain[i] < 0) exit(fprintf(stderr, "gain %g\n", gain[i]));
    free(left), free(rest), free(number), free(variance), free(known), free(room), free(tried), free(gain);
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
    const double half_length = 4 * unit(), blur = 0.3 + 3 * unit();
    cc_step_sums(&picture, n, q, normal, below, above, twins, half_length, blur, 0.002, 0.998, sums);
    cc_steps(n, sums, held, steps);
    beside_lines(&picture, n, q, normal, below, above, twins, half_length, blur, sums);
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
    double *moved = doubles((int)tries * n, 20), *counts = malloc((size_t)tries * 4 * 8);
    double *share = malloc((size_t)(tries * lines) * 8 + 1);
    for (int64_t l = 0; l < lines; l++) first[l] = l;
    cc_met(n, most, offset, slope, lines, first, tries, moved, 2.0, 0.4, 6.0, counts, share);
    for (int64_t k = 0; k < tries * lines; k++)
        if (!(share[k] >= 0 && share[k] <= 1)) exit(fprintf(stderr, "share %g\n", share[k]));
    free(first), free(moved), free(counts), free(share);
    free(pixels), free(q), free(normal), free(twins), free(held), free(below), free(above), free(offset), free(slope);
    free(sums), free(steps), free(p), free(t), free(row), free(mean), free(stiff), free(run);
}

/* The room around samples among segments anywhere, some on a sample's own run, many in one place: from 0 to `most`, no
 * less beyond a twin than before it. Samples asked together get the room and the twins that each gets alone, unless
 * places are so far off that where segments pass is lost in rounding. */
static void rooms(void) {
    const int n = upto(40), m = upto(upto(5) ? 60 : 700);
    const int tame = upto(1);
    const double spread = upto(1) ? 70 : 5, half = 8 * unit(), near = 20 * unit(), most = 30 * unit();
    double *q = doubles(2 * n, spread), *arc = doubles(n, 50), *segments = doubles(4 * m, spread);
    double *segment_arc = doubles(2 * m, 50), *normal = malloc((size_t)n * 16 + 1);
    int32_t *run = malloc((size_t)n * 4 + 1), *segment_run = malloc((size_t)m * 4 + 1);
    for (int i = 0; i < n; i++) {
        const double angle = 7 * unit();
        normal[2 * i] = cos(angle), normal[2 * i + 1] = sin(angle), run[i] = i / 5;
    }
    for (int k = 0; k < m; k++) segment_run[k] = upto(20);
    for (int i = 0; tame && i < 2 * n; i++) q[i] = spread * around();
    for (int k = 0; tame && k < 4 * m; k++) segments[k] = spread * around();
    double *below = malloc((size_t)n * 8 + 1), *above = malloc((size_t)n * 8 + 1);
    double *twins = malloc((size_t)n * 32 + 1), *beyond = malloc((size_t)n * 16 + 1);
    cc_clearance(n, q, normal, run, arc, m, segments, segment_run, segment_arc, half, near, most, below, above, twins,
                 beyond);
    for (int i = 0; i < n; i++) {
        double room[2] = {below[i], above[i]}, alone[2], twin[4], past[2];
        for (int k = 0; k < 2; k++)
            if (!(room[k] >= 0 && room[k] <= beyond[2 * i + k] && beyond[2 * i + k] <= most))
                exit(fprintf(stderr, "room of %g, %g beyond, of %g\n", room[k], beyond[2 * i + k], most));
        cc_clearance(1, q + 2 * i, normal + 2 * i, run + i, arc + i, m, segments, segment_run, segment_arc, half, near,
                     most, alone, alone + 1, twin, past);
        if (!tame) continue;
        if (memcmp(room, alone, 16) || memcmp(twins + 4 * i, twin, 32) || memcmp(beyond + 2 * i, past, 16))
            exit(fprintf(stderr, "a sample has other room when others are asked for with it\n"));
    }
    free(q), free(arc), free(segments), free(segment_arc), free(normal), free(run), free(segment_run);
    free(below), free(above), free(twins), free(beyond);
}

/* How samples move across their lines: not at all where the part slides along the line. */
static void moves(void) {
    const int n = upto(40);
    double *jacobian = doubles(6 * n, 50), *p = doubles(3 * n, 90), *tangent = doubles(3 * n, 1), R[9];
    double *normal = malloc((size_t)n * 16 + 1), *row = malloc((size_t)n * 48 + 1);
    rotation(R);
    cc_edge_rows(n, jacobian, R, p, tangent, normal, row);
    for (int i = 0; i < n; i++) {
        double along = 0, largest = 0, longest = 0;
        for (int k = 0; k < 3; k++) along += row[6 * i + k] * tangent[3 * i + k];
        for (int k = 0; k < 6; k++) largest = fmax(largest, fabs(jacobian[6 * i + k]));
        for (int k = 0; k < 3; k++) longest = fmax(longest, fabs(tangent[3 * i + k]));
        if (isfinite(along) && fabs(along) > 100 * DBL_EPSILON * largest * longest)
            exit(fprintf(stderr, "moves by %g across itself along its line\n", along));
    }
    free(jacobian), free(p), free(tangent), free(normal), free(row);
}

static void grouped(void) {
    const int groups = 1 + upto(12), k = 1 + upto(upto(9) ? 5 : CC_UNKNOWNS - 1), families = 1 + upto(groups - 1);
    const int n = groups + upto(60), tried = 1 + upto(6), more = 1 + upto(4), each = (k + 1) * (k + 2) / 2 + k + 1;
    double *y = doubles(n, 1), *J = doubles(n * k, 5), *known = doubles(n, 1), *of = malloc((size_t)groups * 32);
    double *what = malloc((size_t)tried * 24), *kin = malloc((size_t)families * 8), *theirs = malloc((size_t)more * 16);
    const int own = (k + 1) * (k + 4) / 2 + 1, sums = (groups + families) * own + tried * more * each;
    double *scratch = malloc((size_t)(sums + 4 * n + groups + k) * 8);
    double *out[8];
    const int sizes[8] = {k, k * k, n, groups, groups, groups, groups, n * k};
    for (int i = 0; i < 8; i++) out[i] = malloc((size_t)sizes[i] * 8);
    int64_t *group = malloc((size_t)n * 8), *family = malloc((size_t)groups * 8);
    for (int i = 0; i < n; i++) known[i] = fabs(known[i]) + 1e-6, group[i] = i * groups / n;
    for (int i = 0; i < groups; i++) family[i] = i * families / groups;
    for (int i = 0; i < 3 * groups; i++) of[i] = upto(3) ? unit() : upto(1);
    for (int i = 3 * groups; i < 4 * groups; i++) of[i] = upto(4) > 0;
    for (int i = 0; i < 3 * tried; i++) what[i] = unit();
    for (int i = 0; i < families; i++) kin[i] = upto(3) ? unit() : upto(1);
    for (int i = 0; i < 2 * more; i++) theirs[i] = unit();
    const cc_reweighted asked = {
        .of = {.y = y, .J = J, .group = group, .family = family, .of_group = of, .free = of + groups,
               .expected = of + 2 * groups, .variance = what, .share = what + tried, .prior = what + 2 * tried,
               .family_free = kin, .family_variance = theirs, .family_prior = theirs + more, .n = n,
               .groups = groups, .families = families, .k = k, .tried = tried, .family_tried = more},
        .known = known, .scatter = of + 3 * groups, .uneven = upto(1) * unit(), .robust = upto(2) > 0,
        .rounds = 1 + upto(8)};
    cc_found found = {.x = out[0], .covariance = out[1], .counts = out[2], .of_group = out[3],
                      .mean = out[4], .total = out[5], .off = out[6], .weighed = out[7]};
    if (cc_reweighted_fit(&asked, scratch, &found))
        for (int i = 0; i < n; i++)
            if (isfinite(y[i]) && !(found.counts[i] >= 0 && found.counts[i] <= 1))
                exit(fprintf(stderr, "a datum counts %g times\n", found.counts[i]));
    for (int i = 0; i < 8; i++) free(out[i]);
    free(y), free(J), free(known), free(of), free(what), free(scratch), free(group), free(kin), free(theirs);
    free(family);
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
    double *weight = doubles(count * pixels, 1);
    for (int i = 0; i < count * pixels; i++)
        if (upto(1)) weight[i] = 0;
    cc_mark_picture(&mark, count, pixels, width, places, upto(1) ? weight : NULL, H, terms, dH, levels, loose, value,
                    slopes ? slope : NULL);
    free(r), free(ray), free(span), free(sector), free(places), free(weight);
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
    const cc_depth_view sight = {depth, normal, 1 / 30.f, 1 / 30.f, 1e-3f, 0.1f, width, height};
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

/* Rays from anywhere at triangles of every size, many at one place, on a grid's planes, or none at all. */
static void rays(void) {
    const int n = upto(3) ? upto(60) : 0, points = 1 + upto(40), m = 1 + upto(20), even = upto(2);
    double *vertices = doubles(3 * points, 4), *origin = doubles(3 * m, 4), *way = doubles(3 * m, 1);
    double *reach = malloc((size_t)m * 8);
    int32_t *faces = malloc((size_t)n * 12 + 1), *face = malloc((size_t)m * 4);
    for (int i = 0; even && i < 3 * points; i++) vertices[i] = even == 1 ? 2 : upto(4);
    for (int i = 0; i < 3 * n; i++) faces[i] = upto(points - 1);
    for (int i = 0; i < 3 * m; i++) {
        if (even) origin[i] = upto(8) * 0.5;
        if (upto(2) == 0) way[i] = upto(1) ? 0.0 : -0.0;
    }
    for (int i = 0; i < m; i++) reach[i] = upto(3) ? 9 : upto(1) ? INFINITY : wild();
    cc_rays *tree = cc_rays_new(vertices, faces, n);
    if (!tree) exit(fprintf(stderr, "no memory for rays\n"));
    cc_rays_first(tree, m, origin, way, reach, face);
    for (int i = 0; i < m; i++)
        if (face[i] < -1 || face[i] >= n) exit(fprintf(stderr, "a ray meets face %d of %d\n", (int)face[i], n));
    cc_rays_free(tree);
    free(vertices), free(origin), free(way), free(reach), free(faces), free(face);
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

void lines_and_files(void) { along_lines(), grouped(), marks(), seen(), crossing(), rays(), files(), rooms(), moves(); }
