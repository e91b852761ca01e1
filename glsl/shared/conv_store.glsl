// The end of a dense 3x3 convolution: act(film(value) + residual), stored plain, pixel-shuffled or pixel-unshuffled.
// The residual is a map like the result, after a pixel shuffle; there is none with a pixel unshuffle.
// `at` is a token of the convolution's own result, `channel` a vector of four.
void store_result(uvec2 at, uint channel, vec4 value) {
    uint pixel = at.y * dst_width + at.x;
    uint vector = channel;
    if ((EPILOGUE & FLAG_SHUFFLE) != 0u) {
        // The packer has ordered the outputs [phase][channel], so that a vector stays within one phase.
        uint quarter = dst_channels / 4u;
        uint phase = channel / quarter;
        uvec2 to = at * 2u + uvec2(phase & 1u, phase >> 1);
        pixel = to.y * dst_width * 2u + to.x;
        vector = channel % quarter;
    }
    if ((EPILOGUE & FLAG_FILM) != 0u) {
        value = LOAD_WEIGHTS(film, channel) * value + LOAD_WEIGHTS(film, dst_channels + channel);
    }
    if ((EPILOGUE & FLAG_RESIDUAL) != 0u) value += LOAD(residual, pixel * residual_stride + vector);
    value = activate(value, EPILOGUE);
    if ((EPILOGUE & FLAG_UNSHUFFLE) != 0u) {
        // Channel c of pixel (2x + dx, 2y + dy) becomes channel 4c + 2dy + dx of (x, y): one scalar of four vectors.
        uint to = ((at.y / 2u) * (dst_width / 2u) + at.x / 2u) * dst_stride + channel * 4u;
        uint component = (at.y & 1u) * 2u + (at.x & 1u);
        [[unroll]] for (int c = 0; c < 4; ++c) STORE_COMPONENT(dst, to + c, component, value[c]);
    } else {
        STORE(dst, pixel * dst_stride + vector, value);
    }
}
