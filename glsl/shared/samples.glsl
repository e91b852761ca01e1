// Lone bright pixels (docs/neutral.md): needs read_color and the size of the frame.
const float ABSURD_KEYS = 1e8;           // a lone pixel of more is no light
// A firefly: more than so many keys, and so many times the second-brightest of the neighbours.
const float FIREFLY_KEYS = 1e3;
const float FIREFLY_RATIO = 100.0;

// The brightest sample; +Inf is the largest float.
float brightness(vec3 color) {
    return any(are_infinite(color)) ? MAX_FLOAT : largest_of(light_of(color));
}

// The pixels around one, itself with them, as far as they lie in the frame: first and last.
uvec4 around(uvec2 at, uint reach) {
    return uvec4(max(at, uvec2(reach)) - reach, min(at + reach, uvec2(width, height) - 1u));
}

// The brightest and the second-brightest of the neighbours.
vec2 brightest_around(uvec2 at) {
    vec2 two = vec2(0.0);
    uvec4 box = around(at, 1u);
    for (uint y = box.y; y <= box.w; ++y) {
        for (uint x = box.x; x <= box.z; ++x) {
            if (uvec2(x, y) == at) continue;
            float light = brightness(read_color(uvec2(x, y)));
            two.y = max(two.y, min(two.x, light));
            two.x = max(two.x, light);
        }
    }
    return two;
}

// Absurdly bright and alone: a broken number. A lamp is more than one pixel.
bool is_absurd(float light, float key, vec2 neighbours) {
    return light > ABSURD_KEYS * key && light > FIREFLY_RATIO * neighbours.x;
}

// Much brighter than all of its neighbours but one: a path that found a lamp by chance.
bool is_firefly(float light, float key, vec2 neighbours) {
    return light > FIREFLY_KEYS * key && light > FIREFLY_RATIO * neighbours.y;
}
