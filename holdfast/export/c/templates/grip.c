/* ---- one grip command a sample (holdfast/edge_runtime/grip_control.py) ---- */

const holdfast_grip_options holdfast_own_options = {@OPTIONS@};

/* Whether every option is within its range; NaN fails the comparison. */
static int hf_options_possible(const holdfast_grip_options *options) {
    return @POSSIBLE@;
}

int holdfast_grip_init(holdfast_grip *grip, const holdfast_grip_options *options) {
    const int possible = !options || hf_options_possible(options);
    memset(grip, 0, sizeof *grip);
    grip->options = options && possible ? *options : holdfast_own_options;
    grip->since_s = grip->options.give_back_s;
    return possible ? 0 : -1;
}

/* Whether a sensor presses from the thumb's side. */
static const uint8_t hf_thumb[HOLDFAST_SENSORS] = {@THUMB@};

/* What a finger of the opposing side, and one of the thumb's, counts: the valid ones of a side stand
   in for the others, and a side without any has the force of the other one. */
static void hf_weigh(const uint8_t *valid, double *weights) {
    double all[2] = {0.0, 0.0}, read[2] = {0.0, 0.0};
    weights[0] = weights[1] = 1.0;
    for (int k = 0; k < HOLDFAST_SENSORS; ++k) {
        all[hf_thumb[k]] += 1.0;
        read[hf_thumb[k]] += !valid || valid[k] ? 1.0 : 0.0;
    }
    for (int side = 0; side < 2 && HF_KNOWS_SIDES; ++side) {
        const double sides = 2.0 / (read[0] > 0.0 && read[1] > 0.0 ? 2.0 : 1.0);
        weights[side] = sides * all[side] / (read[side] > 1.0 ? read[side] : 1.0);
    }
}

holdfast_sense holdfast_sense_of(const holdfast_out *out, const holdfast_decision *decision,
                                 const double *sample, const uint8_t *valid, holdfast_wish wish) {
    holdfast_sense sense = {0.0, 0.0, 0.0, 0.0, 0, 0, 0, 0};
    double weights[2];
    hf_weigh(valid, weights);
    for (int k = 0; k < HOLDFAST_SENSORS; ++k) {
        const double x = sample[3 * k], y = sample[3 * k + 1], z = sample[3 * k + 2];
        const double weight = weights[hf_thumb[k]];
        if ((!valid || valid[k]) && fabs(x) + fabs(y) + fabs(z) < HF_LARGEST) {
            sense.grip_n += z > 0.0 ? weight * z : 0.0;
            sense.load_n += weight * sqrt(x * x + y * y);
        }
    }
    sense.grip_n *= 0.5;
    sense.p_risky = (double)out->p_situation[HOLDFAST_RISKY_SLIP];
    /* a lost finger must not calm */
    sense.p_safe = HF_DEGRADED(out) ? 0.0 : (double)out->p_situation[HOLDFAST_SAFE_SLIP];
    sense.known = !out->unknown;
    sense.empty = !out->unknown && out->situation == HOLDFAST_NOTHING;
    sense.opening = (wish & HOLDFAST_OPENING) != 0;
    sense.overridden = decision->override_us > 0;
    return sense;
}

/* The sense with its forces within 0 and HF_LARGEST, and its probabilities within 0 and 1. A sample
   with a number that is NaN is unknown: it says nothing, and the grip is held. */
static holdfast_sense hf_possible(const holdfast_sense *given) {
    holdfast_sense sense = *given;
    sense.known = given->known && given->grip_n == given->grip_n && given->load_n == given->load_n &&
                  given->p_risky == given->p_risky && given->p_safe == given->p_safe;
    sense.grip_n = hf_low(hf_high(given->grip_n, 0.0), HF_LARGEST);
    sense.load_n = hf_low(hf_high(given->load_n, 0.0), HF_LARGEST);
    sense.p_risky = hf_low(hf_high(given->p_risky, 0.0), 1.0);
    sense.p_safe = hf_low(hf_high(given->p_safe, 0.0), 1.0);
    return sense;
}

void holdfast_grip_step(holdfast_grip *grip, const holdfast_sense *given, holdfast_command *command) {
    const holdfast_sense possible = hf_possible(given);
    const holdfast_sense *const sense = &possible;
    int fresh;
    double wanted_n;
    hf_step_friction(grip, sense);
    wanted_n = hf_step_controller(grip, sense, &fresh);
    command->mode = hf_supervise(grip, sense, wanted_n, fresh);
    command->target_n = HOLDFAST_UNIT_IS_N ? grip->given_n : 0.0;
    command->slew_n_s = grip->options.slew_n_s;
    command->feedback = sense->known && sense->p_risky >= grip->options.from_p ? sense->p_risky : 0.0;
    command->mu_hat = grip->mu_hat;
    command->margin = grip->margin;
    command->needed_n = HOLDFAST_UNIT_IS_N ? grip->needed_n : 0.0;
}
