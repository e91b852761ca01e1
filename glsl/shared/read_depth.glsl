// Depth of a pixel; 0 for background: non-finite, not above 0, or as large as renderers write for "nothing".
Plane depth_plane = planes.depth;

float read_depth(uvec2 at) {
#ifdef IMAGES
    float d = texelFetch(depth_image, ivec2(at), 0).r;
#else
    float d = plane_sample(depth_plane, plane_index(depth_plane, at));
#endif
    float background = is_half(depth_plane.format) ? 65000.0 : 1e9;
    return is_finite(d) && d > 0.0 && d < background ? d : 0.0;
}
