// What squares of BLOCK pixels get back of the light that came in: a result x becomes x (1 + gain room(x)).

const uint BLOCK = 64u;

// Nothing where a result is the frame's largest sample already: a lamp that nothing is missing of.
vec3 energy_room(vec3 clean, vec3 largest) {
    return sqrt(max(1.0 - clean / max(largest, vec3(1e-37)), vec3(0.0)));
}

// A pixel's gain, bilinearly between the middles of the squares that hold pixels of the frame, `columns` in a row of
// the map.
vec3 energy_gain(Weights gains, uint columns, uvec2 at, uvec2 frame) {
    vec2 middle = (vec2(at) + 0.5) / float(BLOCK) - 0.5;
    vec2 first = floor(middle);
    vec2 far = middle - first;
    uvec2 low = uvec2(max(first, vec2(0.0)));
    uvec2 high = min(uvec2(first + 1.0), (frame - 1u) / BLOCK);
    vec3 above = mix(gains.v[low.y * columns + low.x].xyz, gains.v[low.y * columns + high.x].xyz, far.x);
    vec3 below = mix(gains.v[high.y * columns + low.x].xyz, gains.v[high.y * columns + high.x].xyz, far.x);
    return mix(above, below, far.y);
}
