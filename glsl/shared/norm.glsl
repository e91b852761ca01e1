// Layer normalisation of a token over `vectors` of four channels, in two passes.
const float NORM_EPSILON = 1e-5;

float mean_of(vec4 sum, uint vectors) {
    return (sum.x + sum.y + sum.z + sum.w) / float(4u * vectors);
}

// From the squares of what is left without the mean.
float scale_of(vec4 squares, uint vectors) {
    return 1.0 / sqrt(mean_of(squares, vectors) + NORM_EPSILON);
}
