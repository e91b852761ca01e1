// A signal of a pixel, as the caller wrote it; one channel three times.
Plane signal_plane = signal.plane;

vec3 read_signal(uvec2 at) {
    return float_samples(signal_plane, at);
}
