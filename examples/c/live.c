/* Live answers from a pipe: a line of numbers for each sample in, a line of JSON for each answer out.
     holdfast export models/holdfast-150hz.onnx --to c --out build/c
     cc -std=c99 -O2 -ffp-contract=off -Ibuild/c -o live examples/c/live.c build/c/holdfast.c -lm
     tail -f -n +1 trial_1/tactile.csv | ./live
   In: Time in s, x y z of every sensor; then, where the recorder wrote the line, a validity flag for
   each sensor at the end: 0 or False, 1 or True. The first lines must be of the unloaded hand. A lost
   finger is nan. Until RATE_ROWS lines have shown the model's rate, the state is unknown; another
   rate, a time that does not rise, or lines of more sensors than the model has, end it with 2. */
#include "holdfast.h"

#include <ctype.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { RATE_ROWS = 20 };
enum { C = HOLDFAST_CHANNELS, S = HOLDFAST_SENSORS, CELLS = 1 + C + 8 + S };
#if HOLDFAST_BIAS_MEDIAN
#error "the bias of this model is a median; this example takes a mean"
#endif

static const char *const STATES[] = {"unknown", "nothing", "grasp", "safe_slip", "risky_slip"};
static const char *const MODES[] = {"idle", "hold", "tighten", "relax", "yield"};

/* A number, or the word false or true as 0 or 1; *end: behind it, at `text` where there is neither. */
static double read_cell(const char *text, char **end) {
    static const char *const WORDS[] = {"false", "true"};
    const double number = strtod(text, end);
    if (*end != text) return number;
    while (*text == ' ') ++text;
    for (int word = 0; word < 2; ++word) {
        const char *left = WORDS[word], *at = text;
        for (; *left && tolower((unsigned char)*at) == *left; ++at) ++left;
        if (*left) continue;
        *end = (char *)at;
        return word;
    }
    return NAN;
}

/* The numbers of a line; returns how many there are: 0 for a header, CELLS + 1 for too many. */
static int read_cells(const char *line, double *cells) {
    int n = 0;
    for (char *end; n <= CELLS; line = end + 1) {
        const double cell = read_cell(line, &end);
        if (end == line) break;
        if (n < CELLS) cells[n] = cell;
        ++n;
        if (*end != ',') break;
    }
    return n;
}

/* Whether a line is of this model's sensors: nothing behind their axes, or a flag of each at its end. */
static int fits(const double *cells, int n) {
    int flags = 0;
    for (int k = n - S; n >= 1 + C + S && n <= CELLS && k < n; ++k) flags += cells[k] == 0.0 || cells[k] == 1.0;
    if (n == 1 + C || flags == S) return 1;
    fprintf(stderr, "a line of %d numbers; this model has %d sensors: Time, %d axes, a flag of each sensor or none\n", n, S, C);
    return 0;
}

/* Removes the bias of the first rows, in place; returns 0 until it is known. */
static int prepare(double *sample) {
    static double sign[C], sum[C];
    static int rows = 0;
    for (int k = 0; k < C && rows < HOLDFAST_BIAS_ROWS; ++k)
        if (!isfinite(sample[k])) return 0;
    for (int k = 0; k < C && rows == 0; ++k) {
        const int turns = sample[k - k % 3 + 2] < -HOLDFAST_TURN_BEYOND && k % 3 >= 3 - HOLDFAST_TURNED_AXES;
        sign[k] = turns ? -1.0 : 1.0;
    }
    for (int k = 0; k < C && rows < HOLDFAST_BIAS_ROWS; ++k) sum[k] += sample[k] * sign[k];
    rows += rows <= HOLDFAST_BIAS_ROWS;
    for (int k = 0; k < C; ++k) {
        const double bias = HOLDFAST_BIAS_ROWS ? sum[k] / HOLDFAST_BIAS_ROWS : 0.0;
        sample[k] = sample[k] * sign[k] - bias;
    }
    return rows >= HOLDFAST_BIAS_ROWS;
}

/* Whether a line may follow the last one: its time rises, and most lines come at the model's rate. */
static int is_in_time(double step_s, int *rows) {
    static int others = 0;
    const double periods = step_s * HOLDFAST_RATE_HZ;
    if (!(step_s > 0.0)) {
        fputs("the time does not rise\n", stderr);
        return 0;
    }
    if (*rows < RATE_ROWS) {
        others += periods < 0.9 || periods > 1.1;
        ++*rows;
    }
    if (2 * others <= RATE_ROWS) return 1;
    fprintf(stderr, "the lines come at another rate than the model's %.4g Hz\n", (double)HOLDFAST_RATE_HZ);
    return 0;
}

int main(void) {
    static const uint8_t none[S] = {0};
    static holdfast_state state;
    holdfast_decision decision = {0};
    holdfast_grip grip;
    holdfast_command command;
    holdfast_out out;
    double last_s = NAN;
    int rows = 0;
    char line[4096];
    if (holdfast_init(&state) != HOLDFAST_OK) return 1;
    holdfast_grip_init(&grip, NULL);
    while (fgets(line, sizeof line, stdin)) {
        double cells[CELLS], *sample = cells + 1;
        uint8_t valid[S];
        holdfast_sense sense;
        const int n = read_cells(line, cells);
        if (n < 1 + C) continue;
        if (!fits(cells, n)) return 2;
        const int known = prepare(sample);
        for (int k = 0; k < S; ++k) valid[k] = known && (n == 1 + C || cells[n - S + k] != 0.0);
        /* samples that never came are steps without a sensor; a longer gap is no different */
        if (!isnan(last_s) && !is_in_time(cells[0] - last_s, &rows)) return 2;
        const double missing = isnan(last_s) ? 0.0 : (cells[0] - last_s) * HOLDFAST_RATE_HZ - 1.5;
        for (int k = 0; k <= HOLDFAST_GAP_SAMPLES && k < missing; ++k)
            holdfast_step_valid(&state, sample, none, &out);
        last_s = cells[0];
        holdfast_step_valid(&state, sample, valid, &out);
        if (rows < RATE_ROWS) out.unknown = 1;
        holdfast_decide(&decision, &out, HOLDFAST_NO_WISH);
        sense = holdfast_sense_of(&out, &decision, sample, valid, HOLDFAST_NO_WISH);
        holdfast_grip_step(&grip, &sense, &command);
        printf("{\"t_s\":%.6f,\"state\":\"%s\",\"p_risky\":%.6f,", cells[0],
               STATES[1 + holdfast_situation(&out)], (double)out.p_situation[3]);
        printf("\"act\":%s,\"mode\":\"%s\",\"target_n\":%.4f}\n", decision.act ? "true" : "false",
               MODES[command.mode], command.target_n);
        fflush(stdout);
    }
    return 0;
}
