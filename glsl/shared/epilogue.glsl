// What a dense kernel does with a sum before it is stored. A pipeline is specialised for it: CPU drivers keep masks for
// every branch, taken or not, and a kernel ends with one for each of its tokens.
#ifndef EPILOGUE_ID
#define EPILOGUE_ID 0
#endif
layout(constant_id = EPILOGUE_ID) const uint EPILOGUE = 0u;
const uint FLAG_RELU = 2u;
const uint FLAG_LEAKY_RELU = 4u;
const uint FLAG_RESIDUAL = 8u;
const uint FLAG_FILM = 16u;
const uint FLAG_SHUFFLE = 32u;
const uint FLAG_UNSHUFFLE = 64u;

vec4 activate(vec4 x, uint epilogue) {
    if ((epilogue & FLAG_RELU) != 0u) return max(x, vec4(0.0));
    if ((epilogue & FLAG_LEAKY_RELU) != 0u) return max(x, 0.01 * x);
    return x;
}
