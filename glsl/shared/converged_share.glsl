// How much of a pixel is the caller's own: needs converged.glsl, the map, its width in pixels and the rows that count.
const float BLEND_PIXELS = 8.0;

// The share of the caller's colour in a pixel: none where it is to be denoised, all where it is far from that.
float converged_share(uvec2 at) {
    uvec2 tile = at / MAP_TILE;
    uint columns = src_width / MAP_TILE;
    uint rows = (bottom + MAP_TILE - 1u) / MAP_TILE;
    if (map.v[tile.y * columns + tile.x] != 0u) return 0.0;
    float nearest = BLEND_PIXELS;
    uvec2 last = min(tile + 1u, uvec2(columns, rows) - 1u);
    for (uint y = max(tile.y, 1u) - 1u; y <= last.y; ++y) {
        for (uint x = max(tile.x, 1u) - 1u; x <= last.x; ++x) {
            if (map.v[y * columns + x] == 0u) continue;
            // From the pixel's middle to the square.
            vec2 low = vec2(uvec2(x, y) * MAP_TILE);
            vec2 beyond = max(max(low - (vec2(at) + 0.5), (vec2(at) + 0.5) - (low + float(MAP_TILE))), vec2(0.0));
            nearest = min(nearest, length(beyond));
        }
    }
    return smoothstep(0.0, BLEND_PIXELS, nearest);
}
