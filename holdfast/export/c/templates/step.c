/* ---- the step ---- */

const char *holdfast_message(int code) {
    switch (code) {
    case HOLDFAST_OK: return "ok";
    case HOLDFAST_STATE_SIZE: return "the state has another size: compile again with this holdfast.h";
    case HOLDFAST_STATE_FOREIGN: return "the state is not from holdfast_init of this model";
    default: return "unknown code";
    }
}

const char *holdfast_digest(void) { return HOLDFAST_DIGEST; }

size_t holdfast_state_bytes(void) { return sizeof(holdfast_state); }

size_t holdfast_out_bytes(void) { return sizeof(holdfast_out); }

int holdfast_init_sized(holdfast_state *state, size_t bytes) {
    if (bytes != sizeof *state) return HOLDFAST_STATE_SIZE;
    memset(state, 0, sizeof *state);
    state->model = HOLDFAST_MODEL;
    return HOLDFAST_OK;
}

/* A state that is not ours gives no answer: everything zero, and unknown. */
static int hf_refuse(holdfast_out *out) {
    memset(out, 0, sizeof *out);
    out->unknown = 1;
    return HOLDFAST_STATE_FOREIGN;
}

int holdfast_features(holdfast_state *state, const double *sample, const uint8_t *valid,
                      float *features, holdfast_out *out) {
    uint8_t all[HOLDFAST_SENSORS];
    if (state->model != HOLDFAST_MODEL) return hf_refuse(out);
    memset(all, 1, sizeof all);
    hf_sense(state->table, sample, valid ? valid : all, features, out);
    return HOLDFAST_OK;
}

int holdfast_step_valid(holdfast_state *state, const double *sample, const uint8_t *valid,
                        holdfast_out *out) {
    float features[HOLDFAST_FEATURES];
    const int code = holdfast_features(state, sample, valid, features, out);
    if (code == HOLDFAST_OK) holdfast_answer(features, out);
    return code;
}

int holdfast_step(holdfast_state *state, const float *sample, holdfast_out *out) {
    double wide[HOLDFAST_CHANNELS];
    for (int k = 0; k < HOLDFAST_CHANNELS; ++k) wide[k] = (double)sample[k];
    return holdfast_step_valid(state, wide, NULL, out);
}
