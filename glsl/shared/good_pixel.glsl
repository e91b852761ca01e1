// Which pixels are mended: needs read_color, stats and the size of the frame.
float brightest(vec3 radiance) {
    return max(radiance.x, max(radiance.y, radiance.z));
}

// The pixels around one, itself with them, as far as they lie in the frame: first and last.
uvec4 around(uvec2 at) {
    return uvec4(max(at, uvec2(1u)) - 1u, min(at + 1u, uvec2(width, height) - 1u));
}

bool is_in_range(vec3 radiance) {
    return is_valid(radiance) && brightest(radiance) <= BAD_PIXEL * stats.key;
}

// Much brighter than all of its neighbours but one: a path that found a lamp by chance, not a lamp.
bool is_isolated(uvec2 at, float light) {
    if (!(light > ISOLATED_KEYS * stats.key)) return false;
    float first = 0.0;
    float second = 0.0;
    uvec4 box = around(at);
    for (uint y = box.y; y <= box.w; ++y) {
        for (uint x = box.x; x <= box.z; ++x) {
            vec3 neighbour = read_color(uvec2(x, y));
            if (uvec2(x, y) == at || !is_in_range(neighbour)) continue;
            float other = brightest(neighbour);
            second = max(second, min(first, other));
            first = max(first, other);
        }
    }
    return light > ISOLATED_RATIO * second;
}

bool is_good(uvec2 at, vec3 radiance) {
    return is_in_range(radiance) && !is_isolated(at, brightest(radiance));
}
