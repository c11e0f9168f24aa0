/* ---- the decision (holdfast/edge_runtime/decision.py) ---- */

/* Whether a sensor is lost; the answer comes from the others. */
#define HF_DEGRADED(out) (!(out)->unknown && (out)->usable_sensors < HOLDFAST_SENSORS)

static int32_t hf_least(int32_t a, int32_t b) { return a < b ? a : b; }

/* The rules within their bounds, so that no sum and no product of them is beyond its type. */
static holdfast_rules hf_bounded(const holdfast_rules *rules) {
    holdfast_rules own = *rules;
    own.arm_samples = hf_within(own.arm_samples, HOLDFAST_MOST_SAMPLES);
    own.act_samples = hf_within(own.act_samples, HOLDFAST_MOST_SAMPLES);
    own.release_samples = hf_within(own.release_samples, HOLDFAST_MOST_SAMPLES);
    own.override_ms = hf_within(own.override_ms, HOLDFAST_MOST_MS);
    own.evidence_ms = hf_within(own.evidence_ms, HOLDFAST_MOST_MS);
    return own;
}

static int32_t hf_time_left(int32_t left_us, int32_t period_us) {
    return left_us > period_us ? left_us - period_us : 0;
}

static int32_t hf_nothing_run(const holdfast_rules *rules, const holdfast_decision *own, int situation) {
    return situation == HOLDFAST_NOTHING ? hf_least(own->nothing_run + 1, rules->release_samples) : 0;
}

static void hf_set_arm(const holdfast_rules *rules, holdfast_decision *own) {
    own->arm = own->risky_run >= rules->arm_samples;
}

static void hf_end_act(const holdfast_rules *rules, holdfast_decision *own, int how) {
    own->act = 0;
    own->ended = (uint8_t)how;
    hf_set_arm(rules, own);
}

static void hf_begin_override(const holdfast_rules *rules, holdfast_decision *own) {
    const uint8_t ended = own->act ? HOLDFAST_ENDED_OVERRIDDEN : own->ended;
    memset(own, 0, sizeof *own);
    own->override_us = 1000 * rules->override_ms;
    own->ended = ended;
}

static void hf_override_lasts(const holdfast_rules *rules, holdfast_decision *own, int situation,
                              int32_t period_us) {
    if (situation != HOLDFAST_UNKNOWN) own->nothing_run = hf_nothing_run(rules, own, situation);
    own->override_us = own->nothing_run >= rules->release_samples
                           ? 0
                           : hf_time_left(own->override_us, period_us);
}

static void hf_count(const holdfast_rules *rules, holdfast_decision *own, int situation, int risky,
                     int32_t period_us) {
    const int32_t most = rules->act_samples + rules->arm_samples;
    own->risky_run = risky ? hf_least(own->risky_run + 1, most) : 0;
    own->nothing_run = hf_nothing_run(rules, own, situation);
    own->evidence_us = risky ? 1000 * rules->evidence_ms : hf_time_left(own->evidence_us, period_us);
}

/* The request, after a known sample has been counted. */
static void hf_request(const holdfast_rules *rules, holdfast_decision *own, int opening) {
    if (opening) {
        if (own->act) hf_end_act(rules, own, HOLDFAST_ENDED_OPENED);
        else hf_set_arm(rules, own);
    } else if (own->risky_run >= rules->act_samples) {
        own->arm = own->act = 1;
        own->ended = HOLDFAST_ENDED_NOT;
    } else if (!own->act) {
        hf_set_arm(rules, own);
    } else if (own->nothing_run >= rules->release_samples) {
        hf_end_act(rules, own, HOLDFAST_ENDED_RELEASED);
    } else if (own->evidence_us == 0) {
        hf_end_act(rules, own, HOLDFAST_ENDED_TIMED_OUT);
    }
}

const holdfast_rules holdfast_own_rules = {@RULES@};

void holdfast_decide_label(const holdfast_rules *rules, holdfast_decision *decision, int situation,
                           int risky_permille, int32_t period_us, holdfast_wish wish) {
    const holdfast_rules bounded = hf_bounded(rules);
    rules = &bounded;
    period_us = hf_within(period_us, INT32_MAX);
    if (wish & HOLDFAST_OVERRIDE) {
        hf_begin_override(rules, decision);
    } else if (decision->override_us > 0) {
        hf_override_lasts(rules, decision, situation, period_us);
    } else if (situation == HOLDFAST_UNKNOWN) {
        if ((wish & HOLDFAST_OPENING) && decision->act) {
            hf_end_act(rules, decision, HOLDFAST_ENDED_OPENED);
        }
    } else {
        const int risky = situation == HOLDFAST_RISKY_SLIP && risky_permille >= rules->min_risky_permille;
        hf_count(rules, decision, situation, risky, period_us);
        hf_request(rules, decision, (wish & HOLDFAST_OPENING) != 0);
    }
}

int holdfast_risky_permille(const holdfast_out *out) {
    int64_t risky = 0, all = 0;
    for (int k = 0; k < HOLDFAST_CLASSES; ++k) {
        all += (int64_t)out->votes[k];
        if (k >= HOLDFAST_CLASSES * 3 / 4) risky += (int64_t)out->votes[k];
    }
    return all > 0 ? (int)(1000 * risky / all) : 0;
}

int holdfast_situation(const holdfast_out *out) {
    if (out->unknown) return HOLDFAST_UNKNOWN;
    if (!HF_DEGRADED(out) || out->situation != HOLDFAST_SAFE_SLIP) return (int)out->situation;
    return out->p_situation[HOLDFAST_RISKY_SLIP] >= out->p_situation[HOLDFAST_GRASP] ? HOLDFAST_RISKY_SLIP
                                                                                   : HOLDFAST_GRASP;
}

void holdfast_decide(holdfast_decision *decision, const holdfast_out *out, holdfast_wish wish) {
    holdfast_decide_label(&holdfast_own_rules, decision, holdfast_situation(out), holdfast_risky_permille(out),
                          HOLDFAST_PERIOD_US, wish);
}
