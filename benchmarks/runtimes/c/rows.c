/* Answers a stream from a file: double sample[C], then uint8 valid[S], a row. Writes after every row
   to stdout: int32 situation (-1: unknown), holdfast_out, the state. Writes to stderr: us a step, the
   median of passes.    rows FILE PASSES */
#include "holdfast.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef struct {
    double sample[HOLDFAST_CHANNELS];
    uint8_t valid[HOLDFAST_SENSORS];
} row_of;

static row_of *rows;
static long n;

static int by_size(const void *one, const void *other) {
    const double a = *(const double *)one, b = *(const double *)other;
    return (a > b) - (a < b);
}

static int read_rows(const char *path) {
    row_of one;
    FILE *file = fopen(path, "rb");
    if (file == NULL) return 1;
    while (fread(one.sample, sizeof one.sample, 1, file) == 1 && fread(one.valid, sizeof one.valid, 1, file) == 1) {
        rows = realloc(rows, (size_t)(n + 1) * sizeof *rows);
        if (rows == NULL) return 1;
        rows[n++] = one;
    }
    return fclose(file) != 0 || n == 0;
}

static int give(const void *from, size_t bytes) { return fwrite(from, bytes, 1, stdout) == 1; }

static int answer(int write) {
    holdfast_state state;
    holdfast_out out;
    memset(&state, 0, sizeof state);
    memset(&out, 0, sizeof out);
    holdfast_init(&state);
    for (long k = 0; k < n; ++k) {
        if (holdfast_step_valid(&state, rows[k].sample, rows[k].valid, &out) != HOLDFAST_OK) return 1;
        if (write) {
            const int32_t label = out.unknown ? HOLDFAST_UNKNOWN : out.situation;
            if (!give(&label, sizeof label) || !give(&out, sizeof out) || !give(&state, sizeof state)) return 1;
        }
    }
    return 0;
}

int main(int count, char **words) {
    const int passes = count == 3 ? atoi(words[2]) : 0;
    double times[1000];
    if (passes < 1 || passes > 1000 || read_rows(words[1]) || answer(1)) return 1;
    for (int pass = 0; pass < passes; ++pass) {
        struct timespec begin, end;
        clock_gettime(CLOCK_MONOTONIC, &begin);
        answer(0);
        clock_gettime(CLOCK_MONOTONIC, &end);
        times[pass] = (1e6 * (double)(end.tv_sec - begin.tv_sec) + 1e-3 * (double)(end.tv_nsec - begin.tv_nsec)) / (double)n;
    }
    qsort(times, (size_t)passes, sizeof *times, by_size);
    fprintf(stderr, "%.4f\n", times[passes / 2]);
    return 0;
}
