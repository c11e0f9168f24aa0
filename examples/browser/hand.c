/* One hand in WebAssembly: the page writes a sample into memory, feeds it, and reads what is there.
   `step` takes a prepared sample, as the ONNX file does; `feed` removes the bias first, steps, decides
   and commands the grip, as examples/c/live.c does. */
#include "holdfast.h"

#include <math.h>
#include <string.h>

enum { C = HOLDFAST_CHANNELS, S = HOLDFAST_SENSORS };
#if HOLDFAST_BIAS_MEDIAN
#error "the bias of this model is a median; this example takes a mean"
#endif
#ifdef __wasm__
#define EXPORTED(name) __attribute__((export_name(#name)))

void *memcpy(void *to, const void *from, size_t n) { return __builtin_memcpy(to, from, n); }
void *memmove(void *to, const void *from, size_t n) { return __builtin_memmove(to, from, n); }
void *memset(void *to, int value, size_t n) { return __builtin_memset(to, value, n); }
#else
#define EXPORTED(name) /* a test calls it in a library of this machine */
#endif

static holdfast_state state;
static holdfast_out out;
static holdfast_decision decision;
static holdfast_grip grip;
static holdfast_command command;
static double sample[C], sign[C], sum[C];
static uint8_t valid[S];
static int rows, is_known;
static holdfast_wish wish; /* what the wearer commands at this sample */

EXPORTED(begin) int begin(void) {
    memset(&state, 0, sizeof state);
    memset(&out, 0, sizeof out);
    memset(&decision, 0, sizeof decision);
    memset(&command, 0, sizeof command);
    memset(sum, 0, sizeof sum);
    rows = is_known = 0;
    wish = HOLDFAST_NO_WISH;
    holdfast_grip_init(&grip, NULL);
    return holdfast_init(&state);
}

EXPORTED(step) int step(void) { return holdfast_step_valid(&state, sample, valid, &out); }

/* Removes the bias of the first rows, in place; returns 0 until it is known. */
static int prepare(void) {
    for (int k = 0; k < C && rows < HOLDFAST_BIAS_ROWS; ++k)
        if (!(fabs(sample[k]) < INFINITY)) return 0;
    for (int k = 0; k < C && rows == 0; ++k) {
        const int turns = sample[k - k % 3 + 2] < -HOLDFAST_TURN_BEYOND && k % 3 >= 3 - HOLDFAST_TURNED_AXES;
        sign[k] = turns ? -1.0 : 1.0;
    }
    for (int k = 0; k < C && rows < HOLDFAST_BIAS_ROWS; ++k) sum[k] += sample[k] * sign[k];
    rows += rows <= HOLDFAST_BIAS_ROWS;
    for (int k = 0; k < C; ++k)
        sample[k] = sample[k] * sign[k] - (HOLDFAST_BIAS_ROWS ? sum[k] / HOLDFAST_BIAS_ROWS : 0.0);
    return rows >= HOLDFAST_BIAS_ROWS;
}

/* harder: forces along the skin are multiplied by this, to see what a stronger pull would do. */
EXPORTED(feed) int feed(double harder) {
    holdfast_sense sense;
    is_known = prepare();
    for (int k = 0; k < C; ++k) sample[k] *= k % 3 == 2 ? 1.0 : harder;
    for (int k = 0; k < S; ++k) valid[k] = (uint8_t)(valid[k] && is_known);
    if (step() != HOLDFAST_OK) return 1;
    holdfast_decide(&decision, &out, wish);
    sense = holdfast_sense_of(&out, &decision, sample, valid, wish);
    holdfast_grip_step(&grip, &sense, &command);
    return 0;
}

EXPORTED(known) int known(void) { return is_known; } /* whether the bias is */
EXPORTED(label) int label(void) { return holdfast_situation(&out); }
EXPORTED(risky) double risky(void) { return (double)out.p_situation[HOLDFAST_RISKY_SLIP]; }
EXPORTED(acts) int acts(void) { return decision.act; }
EXPORTED(mode) int mode(void) { return command.mode; }
EXPORTED(target_n) double target_n(void) { return command.target_n; }
EXPORTED(samples) double *samples(void) { return sample; }
EXPORTED(valids) uint8_t *valids(void) { return valid; }
EXPORTED(answers) const holdfast_out *answers(void) { return &out; }
EXPORTED(states) const holdfast_state *states(void) { return &state; }
EXPORTED(channels) int channels(void) { return C; }
EXPORTED(gap_samples) int gap_samples(void) { return HOLDFAST_GAP_SAMPLES; }
EXPORTED(rate_hz) double rate_hz(void) { return HOLDFAST_RATE_HZ; }
EXPORTED(answers_bytes) int answers_bytes(void) { return (int)sizeof out; }
EXPORTED(states_bytes) int states_bytes(void) { return (int)sizeof state; }
