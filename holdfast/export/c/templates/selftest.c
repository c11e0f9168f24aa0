/* Self-test of Holdfast model @MODEL_ID@: replays the golden sequence that is stored in the ONNX
   file. Prints how many labels differ; the exit code is 0 where none does.
   cc -std=c99 -O2 -ffp-contract=off -o selftest holdfast.c holdfast_selftest.c -lm && ./selftest */
#include "holdfast.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#if HOLDFAST_MODEL != @TAG@
#error "holdfast.h is of another model: generate both again"
#endif

enum { ROWS = @ROWS@, SETTLE = HOLDFAST_SETTLE_SAMPLES, LAST = HOLDFAST_SENSORS - 1 };

@TABLES@
/* The input is made by formula: a pressed, shaken hand with lost and impossible samples. */
static void golden_sample(int row, uint32_t *random, double *sample, uint8_t *valid) {
    const int ramp = 4 * (row < SETTLE ? row : SETTLE), shake = row % 40 < 28 ? 16 : 256;
    for (int k = 0; k < HOLDFAST_CHANNELS; ++k) {
        *random = 1664525u * *random + 1013904223u;
        sample[k] = ((k % 3 == 2 ? ramp : ramp / 4) + (int)((*random >> 16) % (uint32_t)shake)) * @AMPLITUDE@;
    }
    memset(valid, 1, HOLDFAST_SENSORS);
    if (row == SETTLE + 6) valid[0] = 0;
    if (row == SETTLE + 9) sample[1] = NAN;
    if (row == SETTLE + 11) sample[2] = INFINITY;
    if (row == SETTLE + 13) sample[0] = 1e30;
    if (row >= SETTLE + 15 && row < SETTLE + 40) valid[LAST] = 0;
}

/* float32 may differ by 1e-6, as when the ONNX file itself is opened */
static int far(const float *got, const float *wanted, int n) {
    int count = 0;
    for (int k = 0; k < n; ++k) count += !(fabs((double)got[k] - wanted[k]) <= 1e-6 + 1e-6 * fabs(wanted[k]));
    return count;
}

/* The answers to a row against those of the file: votes and labels must be equal. */
#define SAME(name, got, n) for (int k = 0; k < n; ++k) labels += (got)[k] != golden_##name[n * row + k]
#define NEAR(name, got, n) floats += far(got, golden_##name + n * row, n)

int main(void) {
    holdfast_state state;
    holdfast_out out;
    uint32_t random = 12345u;
    int labels = 0, floats = 0;
    if (holdfast_init(&state) != HOLDFAST_OK) return 1;
    for (int row = 0; row < ROWS; ++row) {
        double sample[HOLDFAST_CHANNELS];
        uint8_t valid[HOLDFAST_SENSORS];
        golden_sample(row, &random, sample, valid);
        if (holdfast_step_valid(&state, sample, valid, &out) != HOLDFAST_OK) return 1;
@CHECKS@
    }
    printf("golden: %d rows, %d labels differ\n", ROWS, labels);
    if (floats) printf("golden: %d probabilities differ by more than 1e-6\n", floats);
    return labels || floats;
}
