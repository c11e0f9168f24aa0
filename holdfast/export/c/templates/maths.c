/* ---- arithmetic ---- */

/* total + weight * x. With HOLDFAST_FUSED it is rounded once, as onnxruntime does on processors with
   a fused multiply-add: the numbers of the step then have onnxruntime's own bits. */
#ifdef HOLDFAST_FUSED
#define HF_ADD_PRODUCT(weight, x, total) fma((weight), (x), (total))
#else
#define HF_ADD_PRODUCT(weight, x, total) ((total) + (weight) * (x))
#endif

/* The same for float, rounded once: a product of two floats is exact as a double. */
#define HF_ADD_PRODUCT_F(weight, x, total) ((float)((double)(total) + (double)(weight) * (double)(x)))

/* To the nearest whole number, ties to even. Beyond 2^23 every float is whole. */
HF_HELPER float hf_roundf(float x) {
    const float shift = x < 0.0f ? -8388608.0f : 8388608.0f;
    return fabsf(x) < 8388608.0f ? (x + shift) - shift : x;
}

HF_HELPER double hf_clip(double x, double least, double most) {
    x = x > least ? x : least;
    return x < most ? x : most;
}

HF_HELPER float hf_clipf(float x, float least, float most) {
    x = x > least ? x : least;
    return x < most ? x : most;
}

/* Towards zero, within the range of 32 bits; 0 for NaN. */
HF_HELPER int32_t hf_whole(double x) {
    if (!(x > -2147483648.0)) return x <= -2147483648.0 ? INT32_MIN : 0;
    return x < 2147483647.0 ? (int32_t)x : INT32_MAX;
}

/* An index from 0 to last, for any number: a state that was overwritten leads to no other memory. */
HF_HELPER int32_t hf_within(int32_t index, int32_t last) {
    return index < 0 ? 0 : index > last ? last : index;
}

/* exp(x) for x <= 0, from additions and products alone: the same bits on every processor.
   x = n ln 2 + r with |r| <= ln 2 / 2; the series of exp(r) is cut below 1e-16. */
#ifdef HOLDFAST_SINGLE /* an experiment: every double is a float (benchmarks/runtimes/c/single.h) */
HF_HELPER float hf_exp(float x) { return expf(x); }
#else
HF_HELPER double hf_exp(double x) {
    double n, r, y = 1.0;
    uint64_t bits;
    if (!(x > -700.0)) return 0.0;
    n = (x * 0x1.71547652b82fep0 - 0x1.8p52) + 0x1.8p52;
    r = (x - n * 0x1.62e42feep-1) - n * 0x1.a39ef35793c76p-33;
    for (int k = 14; k > 0; --k) y = 1.0 + y * r / k;
    bits = (uint64_t)((int64_t)n + 1023) << 52;
    memcpy(&n, &bits, sizeof n);
    return y * n;
}
#endif

HF_HELPER void hf_softmax(const float *restrict x, float *restrict y, int n) {
    double total = 0.0;
    float most = x[0];
    for (int k = 1; k < n; ++k) most = x[k] > most ? x[k] : most;
    for (int k = 0; k < n; ++k) total += hf_exp((double)x[k] - (double)most);
    for (int k = 0; k < n; ++k) y[k] = (float)(hf_exp((double)x[k] - (double)most) / total);
}

/* The place of the largest number; of equal ones the last, which is the riskier class. */
HF_HELPER void hf_last_largest(const float *restrict x, int32_t *restrict y, int n) {
    y[0] = 0;
    for (int k = 1; k < n; ++k) y[0] = x[k] >= x[y[0]] ? k : y[0];
}

typedef struct {
    float threshold;
    uint16_t feature;
    int16_t child[2];
} hf_branch_short;

typedef struct {
    float threshold;
    uint16_t feature;
    int32_t child[2];
} hf_branch_long;

/* From a branch to its child: left where feature <= threshold, else (NaN too) right. A leaf stays. */
HF_HELPER int32_t hf_next_short(const hf_branch_short *tree, int32_t at, const float *features) {
    const hf_branch_short *branch = tree + (at < 0 ? 0 : at);
    const int32_t next = branch->child[!(features[branch->feature] <= branch->threshold)];
    return at < 0 ? at : next;
}

/* From a branch to its child: left where feature <= threshold, else (NaN too) right. A leaf stays. */
HF_HELPER int32_t hf_next_long(const hf_branch_long *tree, int32_t at, const float *features) {
    const hf_branch_long *branch = tree + (at < 0 ? 0 : at);
    const int32_t next = branch->child[!(features[branch->feature] <= branch->threshold)];
    return at < 0 ? at : next;
}
