// How window attention on cooperative matrices lies in shared memory. A kernel may define before it includes this
// STAGED_BEFORE_VALUES, vectors of 16 bytes that it needs there for something else.
layout(constant_id = 4) const uint KEYS = 8;     // channels of queries and keys: a multiple of eight
layout(constant_id = 5) const uint VALUES = 16;  // channels of values: a multiple of sixteen
#ifndef STAGED_BEFORE_VALUES
#define STAGED_BEFORE_VALUES 0u
#endif

const uint WINDOW = 64u;                         // tokens
const uint QUERIES = WINDOW / SUBGROUPS;         // of a subgroup, as many as a matrix has rows
const uint KEY_TILES = WINDOW / COLUMNS;
const uint DEPTH_KEYS = (KEYS + 15u) / 16u * 16u; // filled up with zeros
// Strides of rows in shared memory, in vectors of 16 bytes, padded so that rows begin in different banks.
const uint KEY_STRIDE = DEPTH_KEYS / 8u + 1u;
const uint VALUE_STRIDE = VALUES / 8u + 1u;
const uint SCORE_STRIDE = WINDOW / 4u + 1u;
// Queries, keys, and both of the features; later the scores, over them the probabilities and last the results.
const uint KEYS_SIZE = 4u * WINDOW * KEY_STRIDE;
const uint SCORES_SIZE = WINDOW * SCORE_STRIDE;
const uint SCORES_OR_KEYS = KEYS_SIZE > SCORES_SIZE ? KEYS_SIZE : SCORES_SIZE;
const uint VALUES_AT = SCORES_OR_KEYS > STAGED_BEFORE_VALUES ? SCORES_OR_KEYS : STAGED_BEFORE_VALUES;
const uint STAGED_ATTENTION = VALUES_AT + WINDOW * VALUE_STRIDE;
