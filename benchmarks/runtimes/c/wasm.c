/* One hand in WebAssembly: the host writes a sample into memory, steps, and reads what is there. */
#include "holdfast.h"

#include <string.h>

void *memcpy(void *to, const void *from, size_t n) { return __builtin_memcpy(to, from, n); }
void *memmove(void *to, const void *from, size_t n) { return __builtin_memmove(to, from, n); }
void *memset(void *to, int value, size_t n) { return __builtin_memset(to, value, n); }

static holdfast_state state;
static holdfast_out out;
static double sample[HOLDFAST_CHANNELS];
static uint8_t valid[HOLDFAST_SENSORS];

#define EXPORTED(name) __attribute__((export_name(#name)))

EXPORTED(begin) int begin(void) {
    memset(&state, 0, sizeof state);
    memset(&out, 0, sizeof out);
    return holdfast_init(&state);
}
EXPORTED(step) int step(void) { return holdfast_step_valid(&state, sample, valid, &out); }
EXPORTED(label) int label(void) { return out.unknown ? HOLDFAST_UNKNOWN : out.situation; }
EXPORTED(samples) double *samples(void) { return sample; }
EXPORTED(valids) uint8_t *valids(void) { return valid; }
EXPORTED(answers) const holdfast_out *answers(void) { return &out; }
EXPORTED(states) const holdfast_state *states(void) { return &state; }
EXPORTED(channels) int channels(void) { return HOLDFAST_CHANNELS; }
EXPORTED(answers_bytes) int answers_bytes(void) { return (int)sizeof out; }
EXPORTED(states_bytes) int states_bytes(void) { return (int)sizeof state; }
