/* Answers prepared samples from stdin by onnxruntime's C API: 18 numbers a line, nan for a lost finger.
   Prints the situation of each, -1 for unknown; at the end, to stderr, microseconds a step.
     cc -std=c99 -D_POSIX_C_SOURCE=200809L -O2 -ION/include -o hand examples/onnxruntime-c/hand.c -ldl
     ./hand PATH/libonnxruntime.so models/holdfast-150hz.onnx < samples.txt
   ON: a release of onnxruntime, unpacked. Its header may be older than the library, not newer. */
#include <onnxruntime_c_api.h>

#include <dlfcn.h>
#include <stdio.h>
#include <time.h>

enum { CHANNELS = 18, SENSORS = CHANNELS / 3, STATE_INPUT = 3 };

static const OrtApi *ort;

static void stop(const char *what, const char *why) {
    fprintf(stderr, "%s: %s\n", what, why);
    exit(1);
}

static void must(OrtStatus *status) {
    if (status) stop("onnxruntime", ort->GetErrorMessage(status));
}

/* The library is opened only now, after telemetry is off. */
static void open_library(const char *path) {
    const OrtApiBase *(*base)(void) = NULL;
    setenv("ORT_DISABLE_TELEMETRY", "1", 1);
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library) stop("hand", dlerror());
    *(void **)&base = dlsym(library, "OrtGetApiBase");
    if (!base) stop(path, "no onnxruntime library");
    ort = base()->GetApi(ORT_API_VERSION);
    if (!ort) stop(path, "older than the header");
}

static OrtSession *open_model(const char *path) {
    OrtEnv *env;
    OrtSessionOptions *options;
    OrtSession *session;
    must(ort->CreateEnv(ORT_LOGGING_LEVEL_ERROR, "hand", &env));
    must(ort->DisableTelemetryEvents(env));
    must(ort->CreateSessionOptions(&options));
    must(ort->SetIntraOpNumThreads(options, 1));
    must(ort->CreateSession(env, path, options, &session));
    return session;
}

/* Rows of the state table, which differ from model to model. */
static int rows_of_state(const OrtSession *session) {
    OrtTypeInfo *info;
    const OrtTensorTypeAndShapeInfo *table;
    int64_t shape[3];
    must(ort->SessionGetInputTypeInfo(session, STATE_INPUT, &info));
    must(ort->CastTypeInfoToTensorInfo(info, &table));
    must(ort->GetDimensions(table, shape, 3));
    ort->ReleaseTypeInfo(info);
    return (int)shape[1];
}

/* A tensor on the caller's memory; rows of the shape [1, lanes, width], or [1] where lanes is 0. */
static OrtValue *tensor(void *data, size_t bytes, int lanes, int width, ONNXTensorElementDataType type) {
    static OrtMemoryInfo *memory;
    const int64_t shape[] = {1, lanes, width};
    OrtValue *value;
    if (!memory) must(ort->CreateCpuMemoryInfo(OrtDeviceAllocator, OrtMemTypeDefault, &memory));
    must(ort->CreateTensorWithDataAsOrtValue(memory, data, bytes, shape, lanes ? 3 : 1, type, &value));
    return value;
}
#define TENSOR(data, lanes, width, type) tensor(&(data), sizeof(data), lanes, width, ONNX_TENSOR_ELEMENT_DATA_TYPE_##type)

static double now_us(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return 1e6 * (double)now.tv_sec + 1e-3 * (double)now.tv_nsec;
}

int main(int argc, char **argv) {
    static const char *const inputs[] = {"sample", "valid", "reset", "state"};
    static const char *const outputs[] = {"situation", "unknown", "state_out"};
    static double sample[CHANNELS];
    static bool valid[SENSORS], reset = true, unknown; /* the model finds the nan of a lost finger itself */
    static int64_t situation;
    double spent_us = 0.0;
    long rows = 0;
    char line[4096];
    if (argc != 3) stop("usage", "hand LIBRARY MODEL < samples");
    open_library(argv[1]);
    OrtSession *session = open_model(argv[2]);
    const int lanes = rows_of_state(session);
    const size_t bytes = (size_t)lanes * CHANNELS * sizeof(double);
    OrtValue *state[2]; /* each step reads one and writes the other */
    for (int k = 0; k < 2; ++k) {
        void *table = calloc(1, bytes);
        if (!table) stop("hand", "no memory");
        state[k] = tensor(table, bytes, lanes, CHANNELS, ONNX_TENSOR_ELEMENT_DATA_TYPE_DOUBLE);
    }
    const OrtValue *given[] = {TENSOR(sample, 1, CHANNELS, DOUBLE), TENSOR(valid, 1, SENSORS, BOOL),
                               TENSOR(reset, 1, 1, BOOL), NULL};
    OrtValue *answers[] = {TENSOR(situation, 0, 0, INT64), TENSOR(unknown, 0, 0, BOOL), NULL};
    for (int k = 0; k < SENSORS; ++k) valid[k] = true;
    for (; fgets(line, sizeof line, stdin); ++rows) {
        char *at = line, *end;
        for (int k = 0; k < CHANNELS; ++k, at = end) {
            sample[k] = strtod(at, &end);
            if (end == at) stop("a line", "fewer than 18 numbers");
        }
        given[3] = state[rows % 2];
        answers[2] = state[1 - rows % 2];
        const double begin_us = now_us();
        must(ort->Run(session, NULL, inputs, given, 4, outputs, 3, answers));
        spent_us += now_us() - begin_us;
        reset = false;
        printf("%d\n", unknown ? -1 : (int)situation);
    }
    fprintf(stderr, "%.4f\n", spent_us / (double)(rows ? rows : 1));
    return 0;
}
