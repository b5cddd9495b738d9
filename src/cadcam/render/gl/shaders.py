"""The GLSL of the gl renderer. Everything that determines a returned number is computed in double precision.

No component of a vector is chosen by a variable: NVIDIA's compiler (580.159) cannot do it for vectors of doubles.

Per view, in order: PLANES (1/z of each face as a linear function of the undistorted plane); TRANSFORM (vertices to clip
space) for cameras without distortion; for all others BEND (vertices to pixels), LARGE (the faces to be cut first) and
EDGES (which rays meet each face); VERTEX, WIDEN and FRAGMENT (which face each pixel centre sees); RESOLVE (everything
else from that face's number).
"""

from cadcam.render.gl.bend import LONGEST_PX

HEAD = """#version 430 core
layout(std430, binding = 0) readonly buffer Vertices { double vertex[]; };
layout(std430, binding = 1) readonly buffer Faces { int corner[]; };
layout(std430, binding = 2) readonly buffer Pose {
    double rotation[9];      // camera_from_world
    double translation[3];
    double clip[16];         // clip_from_world
    double plane_of[6];      // undistorted plane from pixel: the two upper rows of inv(K)
};
dvec3 world(int i) { return dvec3(vertex[3 * i], vertex[3 * i + 1], vertex[3 * i + 2]); }
dvec3 row(int k) { return dvec3(rotation[3 * k], rotation[3 * k + 1], rotation[3 * k + 2]); }
dvec3 turned(dvec3 v) { return dvec3(dot(row(0), v), dot(row(1), v), dot(row(2), v)); }
dvec3 moved(dvec3 v) { return turned(v) + dvec3(translation[0], translation[1], translation[2]); }
double depth_of(dvec3 v) { return dot(row(2), v) + translation[2]; }
"""

GROUPS = """
layout(local_size_x = 64) in;
int item() { return int(gl_GlobalInvocationID.x + gl_GlobalInvocationID.y * gl_NumWorkGroups.x * 64u); }
"""

TRANSFORM = (
    HEAD
    + GROUPS
    + """
layout(std430, binding = 3) writeonly buffer Positions { vec4 position[]; };
uniform int count;
float clipped(int k, dvec3 v) {
    return float(dot(dvec3(clip[4 * k], clip[4 * k + 1], clip[4 * k + 2]), v) + clip[4 * k + 3]);
}
void main() {
    int i = item();
    if (i >= count) return;
    dvec3 v = world(i);
    position[i] = vec4(clipped(0, v), clipped(1, v), clipped(2, v), clipped(3, v));
}
"""
)

# A face seen edge-on has no stable plane: its 1/z stays between those of its corners.
PLANES = (
    HEAD
    + GROUPS
    + """
layout(std430, binding = 3) writeonly buffer Planes { float plane[]; };
uniform int count;
void main() {
    int f = item();
    if (f >= count) return;
    dvec3 p = world(corner[3 * f]), q = world(corner[3 * f + 1]), r = world(corner[3 * f + 2]);
    dvec3 n = turned(cross(q - p, r - p));
    double d = dot(n, moved(p));
    double z0 = depth_of(p), z1 = depth_of(q), z2 = depth_of(r);
    double low = min(z0, min(z1, z2)), high = max(z0, max(z1, z2));
    vec2 span = vec2(high > 0.0 ? 1.0 / high : 0.0, low > 0.0 ? 1.0 / low : 3.0e38);
    vec3 abc = d != 0.0 ? vec3(n / d) : vec3(0.0, 0.0, span.x);
    if (high <= 0.0 || any(isnan(abc)) || any(isinf(abc))) { abc = vec3(0.0, 0.0, span.x); }
    plane[5 * f] = abc.x; plane[5 * f + 1] = abc.y; plane[5 * f + 2] = abc.z;
    plane[5 * f + 3] = span.x; plane[5 * f + 4] = high > 0.0 ? span.y : 0.0;
}
"""
)

VERTEX = """#version 430 core
in vec4 position;
void main() { gl_Position = position; }
"""

# A ray meets a triangle if it is on the inner side of the planes through the eye and each edge. For either face at an
# edge that plane is computed from the same ends in the same order, so a ray meets one of the two: exactly one, since
# a ray in the plane itself belongs to the side from which its first coefficient is positive.
EDGES = (
    HEAD
    + GROUPS
    + """
layout(std430, binding = 3) writeonly buffer Edges { float edge[]; };
uniform int count;
bool before(dvec3 a, dvec3 b) {
    return a.x != b.x ? a.x < b.x : a.y != b.y ? a.y < b.y : a.z < b.z;
}
void store(int k, dvec3 n) { edge[k] = float(n.x); edge[k + 1] = float(n.y); edge[k + 2] = float(n.z); }
dvec3 through(dvec3 a, dvec3 b) {
    dvec3 n = before(a, b) ? cross(moved(a), moved(b)) : -cross(moved(b), moved(a));
    double whole = dot(n, n);
    return whole > 0.0 ? n / sqrt(whole) : dvec3(0.0);
}
void main() {
    int f = item();
    if (f >= count) return;
    dvec3 p = world(corner[3 * f]), q = world(corner[3 * f + 1]), r = world(corner[3 * f + 2]);
    double volume = dot(turned(cross(q - p, r - p)), moved(p));
    double side = volume > 0.0 ? 1.0 : volume < 0.0 ? -1.0 : 0.0;
    store(9 * f, side * through(p, q));
    store(9 * f + 3, side * through(q, r));
    store(9 * f + 6, side * through(r, p));
}
"""
)

# Positions are pixels x and y, the bending there (`render.gl.bend`), and a bit for each side of the frustum that the
# vertex is beyond. The table is interpolated here: texture units know 256 steps between two texels.
BEND = (
    HEAD
    + GROUPS
    + """
layout(std430, binding = 3) writeonly buffer Positions { vec4 position[]; };
uniform int count;
uniform sampler2D nodes;
uniform vec2 first, per;          // of the table: its lowest direction, cells a unit
uniform vec2 low, high;           // of the frustum
uniform float nearest;
void main() {
    int i = item();
    if (i >= count) return;
    dvec3 p = moved(world(i));
    int beyond = int(p.z < nearest) | int(p.x < low.x * p.z) << 1 | int(p.x > high.x * p.z) << 2
               | int(p.y < low.y * p.z) << 3 | int(p.y > high.y * p.z) << 4;
    vec2 at = p.z < nearest ? vec2(-1.0) : (vec2(p.xy / (p.z + sqrt(dot(p, p)))) - first) * per;
    ivec2 cell = ivec2(floor(at));
    if (any(lessThan(cell, ivec2(0))) || any(greaterThan(cell, textureSize(nodes, 0) - 2))) {
        position[i] = vec4(0.0, 0.0, -1.0, float(beyond));
        return;
    }
    at -= vec2(cell);
    vec4 node = texelFetch(nodes, cell, 0);
    vec2 a = mix(node.xy, texelFetch(nodes, cell + ivec2(1, 0), 0).xy, at.x);
    vec2 b = mix(texelFetch(nodes, cell + ivec2(0, 1), 0).xy, texelFetch(nodes, cell + ivec2(1, 1), 0).xy, at.x);
    position[i] = vec4(mix(a, b, at.y), node.z, float(beyond));
}
"""
)

_WIDEST_PX = 48.0  # faces whose edges may be further than that from their chords are cut

# How far the image of an edge may be from its chord: twice what the largest curvature around its ends makes of it, px.
_BULGE = (
    f"const float longest = {LONGEST_PX}, widest = {_WIDEST_PX};"
    + """
float bulge(vec4 a, vec4 b) {
    vec2 along = a.xy - b.xy;
    float square = dot(along, along);
    return min(a.z, b.z) < 0.0 || square > longest * longest ? 1.0e30 : 0.25 * max(a.z, b.z) * square;
}
float bulge(vec4 a, vec4 b, vec4 c) { return max(bulge(a, b), max(bulge(b, c), bulge(c, a))); }
"""
)

LARGE = (
    HEAD
    + GROUPS
    + _BULGE
    + """
layout(std430, binding = 3) readonly buffer Positions { vec4 position[]; };
layout(std430, binding = 4) buffer Large { int found, large[]; };
uniform int count;
void main() {
    int f = item();
    if (f >= count) return;
    vec4 a = position[corner[3 * f]], b = position[corner[3 * f + 1]], c = position[corner[3 * f + 2]];
    if ((int(a.w) & int(b.w) & int(c.w)) == 0 && bulge(a, b, c) > widest) large[atomicAdd(found, 1)] = f;
}
"""
)

# Draws a triangle of pixels with all that is within `reach` and its bulge of it: each edge moved outwards, each corner
# cut twice along tangents of the circle around it. The fragment stage discards the excess.
WIDEN = (
    """#version 430 core
layout(triangles) in;
layout(triangle_strip, max_vertices = 6) out;
uniform vec2 half_size;      // of the tile, in samples
uniform vec2 corner;         // of the tile, px
uniform float samples;       // a side of a pixel
uniform float reach;         // px
uniform bool pieces;
"""
    + _BULGE
    + """
vec2 at(int k) { return (samples * (gl_in[k].gl_Position.xy + 0.5 - corner) - half_size) * vec2(1.0, -1.0); }
void put(vec2 p) {
    gl_PrimitiveID = gl_PrimitiveIDIn;
    gl_Position = vec4(p / half_size, 0.0, 1.0);
    EmitVertex();
}
void main() {
    float more = pieces ? 0.0 : bulge(gl_in[0].gl_Position, gl_in[1].gl_Position, gl_in[2].gl_Position);
    if (more > 1.001 * widest) return;      // drawn in pieces; at the limit rather twice than never
    float width = samples * (reach + more);
    vec2 p[3] = vec2[3](at(0), at(1), at(2));
    vec2 low = min(p[0], min(p[1], p[2])) - width, high = max(p[0], max(p[1], p[2])) + width;
    if (any(greaterThan(low, half_size)) || any(lessThan(high, -half_size))) return;
    vec2 d[3];
    float shortest = 1.0e30;
    if (determinant(mat2(p[1] - p[0], p[2] - p[0])) < 0.0) { vec2 swap = p[1]; p[1] = p[2]; p[2] = swap; }
    for (int k = 0; k < 3; ++k) {
        d[k] = p[(k + 1) % 3] - p[k];
        shortest = min(shortest, length(d[k]));
        d[k] = normalize(d[k]);
    }
    if (!(shortest > 0.01)) {
        put(low); put(vec2(high.x, low.y)); put(vec2(low.x, high.y)); put(high);
        EndPrimitive();
        return;
    }
    vec2 rim[6];
    for (int k = 0; k < 3; ++k) {
        vec2 a = d[(k + 2) % 3], b = d[k];
        float c = sqrt(max(0.0, 0.5 + 0.5 * dot(a, b)));      // cosine of half the turn
        float t = sqrt((1.0 - c) / (1.0 + c));                // tangent of a quarter of it
        rim[2 * k] = p[k] + width * (vec2(a.y, -a.x) + t * a);
        rim[2 * k + 1] = p[k] + width * (vec2(b.y, -b.x) - t * b);
    }
    put(rim[0]); put(rim[1]); put(rim[5]); put(rim[2]); put(rim[4]); put(rim[3]);
    EndPrimitive();
}
"""
)

# u of a pixel without a direction is marked by a huge number; window row 0 is the picture's last.
_FRAGMENT = """
layout(std430, binding = 3) readonly buffer Planes { float plane[]; };
uniform int height;
uniform vec2 depth_range;   // nearest, 1 / (farthest - nearest)
out int face;
void show(int f, vec2 u) {
    int k = 5 * f;
    float w = clamp(plane[k] * u.x + plane[k + 1] * u.y + plane[k + 2], plane[k + 3], plane[k + 4]);
    if (!(w > 0.0)) discard;
    gl_FragDepth = clamp((1.0 / w - depth_range.x) * depth_range.y, 0.0, 0.999999);
    face = f;
}
ivec2 here() { return ivec2(int(gl_FragCoord.x), height - 1 - int(gl_FragCoord.y)); }
"""

FRAGMENT = (
    "#version 430 core"
    + _FRAGMENT
    + """
uniform vec3 plane_x, plane_y;
void main() {
    vec3 pixel = vec3(vec2(here()), 1.0);
    show(gl_PrimitiveID, vec2(dot(plane_x, pixel), dot(plane_y, pixel)));
}
"""
)

BENT_FRAGMENT = (
    "#version 430 core"
    + _FRAGMENT
    + """
layout(std430, binding = 4) readonly buffer Edges { float edge[]; };
layout(std430, binding = 5) readonly buffer Pieces { int piece_of[]; };
uniform bool pieces;
uniform sampler2D table;
bool within(int k, vec2 u) {
    vec3 n = vec3(edge[k], edge[k + 1], edge[k + 2]);
    float e = n.x * u.x + n.y * u.y + n.z;
    return e > 0.0 || (e == 0.0 && (n.x != 0.0 ? n.x : n.y != 0.0 ? n.y : n.z) > 0.0);
}
void main() {
    vec2 u = texelFetch(table, here(), 0).xy;
    int f = pieces ? piece_of[gl_PrimitiveID] : gl_PrimitiveID;
    if (!(u.x < 1.0e30) || !within(9 * f, u) || !within(9 * f + 3, u) || !within(9 * f + 6, u)) discard;
    show(f, u);
}
"""
)

RESOLVE = (
    HEAD
    + GROUPS
    + """
layout(std430, binding = 3) readonly buffer Kinds { ivec2 kind[]; };   // of faces: part, colour
layout(std430, binding = 4) readonly buffer Colors { float color[]; };
layout(std430, binding = 5) writeonly buffer Layers { uint layer[]; };
uniform ivec2 size;         // of the layers
uniform int samples;        // a side of a pixel
uniform bool distorted;
uniform int at_image, at_coverage, at_depth, at_normal, at_part, at_face;   // words; -1 = not asked for
uniform vec4 light;         // ambient, head, fill, back
uniform vec3 fill_from, back_from;
uniform vec3 background;
uniform isampler2D ids;
uniform sampler2D depths;
uniform sampler2D table;

const uint BACKGROUND_DEPTH = 0x7f800000u;
int face;
double depth;
vec3 normal, ray;

bool met(ivec2 at) {
    ivec2 texel = ivec2(at.x, size.y * samples - 1 - at.y);
    if (texelFetch(depths, texel, 0).r >= 1.0) return false;
    face = texelFetch(ids, texel, 0).r;
    dvec3 u = dvec3(plane_of[0] * at.x + plane_of[1] * at.y + plane_of[2], plane_of[4] * at.y + plane_of[5], 1.0);
    if (distorted) {
        vec4 halves = texelFetch(table, at, 0);   // high and low halves
        u = dvec3(double(halves.x) + double(halves.z), double(halves.y) + double(halves.w), 1.0);
    }
    dvec3 p = world(corner[3 * face]), q = world(corner[3 * face + 1]), r = world(corner[3 * face + 2]);
    dvec3 n = turned(cross(q - p, r - p));
    double whole = dot(n, n);
    n = whole > 0.0 ? n / sqrt(whole) : dvec3(0.0);
    double facing = dot(n, u), z0 = depth_of(p), z1 = depth_of(q), z2 = depth_of(r);
    double low = min(z0, min(z1, z2)), high = max(z0, max(z1, z2));
    depth = facing != 0.0 ? clamp(dot(n, moved(p)) / facing, low, high) : low;
    normal = vec3(facing > 0.0 ? -n : n);
    ray = vec3(u / sqrt(dot(u, u)));
    return true;
}

vec3 shaded() {
    int k = 3 * kind[face].y;
    float head = clamp(dot(normal, -ray), 0.0, 1.0);
    float fill = clamp(dot(normal, fill_from), 0.0, 1.0), back = clamp(dot(normal, back_from), 0.0, 1.0);
    float bright = light.x + light.y * head + light.z * fill + light.w * back;
    return clamp(vec3(color[k], color[k + 1], color[k + 2]) * bright, 0.0, 1.0);
}

void store(int word, vec3 v) {
    layer[word] = floatBitsToUint(v.x);
    layer[word + 1] = floatBitsToUint(v.y);
    layer[word + 2] = floatBitsToUint(v.z);
}

void main() {
    int i = item();
    if (i >= size.x * size.y) return;
    ivec2 at = ivec2(i % size.x, i / size.x);
    vec3 sum = vec3(0.0);
    int seen = 0;
    for (int y = 0; y < samples; ++y)
        for (int x = 0; x < samples; ++x) {
            bool hit = met(at * samples + ivec2(x, y));
            seen += int(hit);
            if (at_image >= 0) sum += hit ? shaded() : background;
        }
    if (at_image >= 0) store(at_image + 3 * i, sum / float(samples * samples));
    if (at_coverage >= 0) layer[at_coverage + i] = floatBitsToUint(float(seen) / float(samples * samples));
    if (at_depth >= 0) layer[at_depth + i] = seen > 0 ? floatBitsToUint(float(depth)) : BACKGROUND_DEPTH;
    if (at_normal >= 0) store(at_normal + 3 * i, seen > 0 ? normal : vec3(0.0));
    if (at_part >= 0) layer[at_part + i] = uint(seen > 0 ? kind[face].x : -1);
    if (at_face >= 0) layer[at_face + i] = uint(seen > 0 ? face : -1);
}
"""
)
