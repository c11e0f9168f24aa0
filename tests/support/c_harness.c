/* Feeds records from stdin to a C form and writes its answers to stdout, all in binary.
   step: double sample[C], uint8 valid[S], uint8 fresh -> float features[F], holdfast_out, state
   answer: float features[F] -> holdfast_out
   decide: int32 rules[6], fresh, situation, permille, period_us, wish -> holdfast_decision
   hand: double sample[C], uint8 valid[S], uint8 fresh -> int32 label, double grip_n, load_n, p_risky,
         p_safe, uint8 known, empty, act
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
    double numbers[4];
    uint8_t fresh, flags[4];
    holdfast_grip own;
    holdfast_grip_options options;
    holdfast_command command;
    memset(&command, 0, sizeof command);
    while (take(&options, sizeof options) && take(&fresh, 1) && take(numbers, sizeof numbers) &&
           take(flags, sizeof flags)) {
        const holdfast_sense sense = {numbers[0], numbers[1], numbers[2], numbers[3],
                                      flags[0],   flags[1],   flags[2],   flags[3]};
        if (fresh) holdfast_grip_init(&own, &options);
        holdfast_grip_step(&own, &sense, &command);
        give(&command, sizeof command);
    }
    return 0;
}

static int hand(void) {
    double sample[HOLDFAST_CHANNELS];
    uint8_t valid[HOLDFAST_SENSORS], fresh;
    holdfast_state state;
    holdfast_decision decision;
    holdfast_out out;
    memset(&out, 0, sizeof out);
    while (take(sample, sizeof sample) && take(valid, sizeof valid) && take(&fresh, 1)) {
        holdfast_sense sense;
        double felt[4];
        uint8_t flags[3];
        int32_t label;
        if (fresh) {
            holdfast_init(&state);
            memset(&decision, 0, sizeof decision);
        }
        if (holdfast_step_valid(&state, sample, valid, &out) != HOLDFAST_OK) return 1;
        holdfast_decide(&decision, &out, HOLDFAST_NO_WISH);
        sense = holdfast_sense_of(&out, &decision, sample, valid, HOLDFAST_NO_WISH);
        label = holdfast_situation(&out);
        felt[0] = sense.grip_n, felt[1] = sense.load_n, felt[2] = sense.p_risky, felt[3] = sense.p_safe;
        flags[0] = sense.known, flags[1] = sense.empty, flags[2] = decision.act;
        give(&label, sizeof label);
        give(felt, sizeof felt);
        give(flags, sizeof flags);
    }
    return 0;
}

int main(int argc, char **argv) {
    const char *mode = argc > 1 ? argv[1] : "";
    if (!strcmp(mode, "step")) return step();
    if (!strcmp(mode, "answer")) return answer();
    if (!strcmp(mode, "decide")) return decide();
    if (!strcmp(mode, "hand")) return hand();
    return strcmp(mode, "grip") ? 2 : grip();
}
