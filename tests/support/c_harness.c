/* Feeds records from stdin to a C form and writes its answers to stdout, all in binary.
   step: double sample[C], uint8 valid[S], uint8 fresh -> float features[F], holdfast_out, state
   answer: float features[F] -> holdfast_out
   decide: int32 rules[6], fresh, situation, permille, period_us, wish -> holdfast_decision
   grip: double options[9], uint8 fresh; then double sense[4], uint8 flags[4] -> holdfast_command */
#include "holdfast.h"

#include <stdio.h>
#include <string.h>

static int take(void *into, size_t bytes) { return fread(into, 1, bytes, stdin) == bytes; }

static void give(const void *from, size_t bytes) { fwrite(from, 1, bytes, stdout); }

static int step(void) {
    double sample[HOLDFAST_CHANNELS];
    uint8_t valid[HOLDFAST_SENSORS], fresh;
    float features[HOLDFAST_FEATURES];
    holdfast_state state;
    holdfast_out out;
    memset(&out, 0, sizeof out);
    while (take(sample, sizeof sample) && take(valid, sizeof valid) && take(&fresh, 1)) {
        if (fresh) holdfast_init(&state);
        if (holdfast_features(&state, sample, valid, features, &out) != HOLDFAST_OK) return 1;
        holdfast_answer(features, &out);
        give(features, sizeof features);
        give(&out, sizeof out);
        give(state.table, sizeof state.table);
    }
    return 0;
}

static int answer(void) {
    float features[HOLDFAST_FEATURES];
    holdfast_out out;
    memset(&out, 0, sizeof out);
    while (take(features, sizeof features)) {
        holdfast_answer(features, &out);
        give(&out, sizeof out);
    }
    return 0;
}

static int decide(void) {
    int32_t in[11];
    holdfast_decision decision;
    memset(&decision, 0, sizeof decision);
    while (take(in, sizeof in)) {
        const holdfast_rules rules = {in[0], in[1], in[2], in[3], in[4], in[5]};
        if (in[6]) memset(&decision, 0, sizeof decision);
        holdfast_decide_label(&rules, &decision, in[7], in[8], in[9], in[10]);
        give(&decision, sizeof decision);
    }
    return 0;
}

static int grip(void) {
    double options[9], numbers[4];
    uint8_t fresh, flags[4];
    holdfast_grip own;
    holdfast_command command;
    memset(&command, 0, sizeof command);
    while (take(options, sizeof options) && take(&fresh, 1) && take(numbers, sizeof numbers) &&
           take(flags, sizeof flags)) {
        const holdfast_sense sense = {numbers[0], numbers[1], numbers[2], numbers[3],
                                      flags[0],   flags[1],   flags[2],   flags[3]};
        holdfast_grip_options given;
        memcpy(&given, options, sizeof given);
        if (fresh) holdfast_grip_init(&own, &given);
        holdfast_grip_step(&own, &sense, &command);
        give(&command, sizeof command);
    }
    return 0;
}

int main(int argc, char **argv) {
    const char *mode = argc > 1 ? argv[1] : "";
    if (!strcmp(mode, "step")) return step();
    if (!strcmp(mode, "answer")) return answer();
    if (!strcmp(mode, "decide")) return decide();
    return strcmp(mode, "grip") ? 2 : grip();
}
