/* The physics of scene.h: one implicit step, as holdfast/simulation/physics/solver.py takes it. */
#include "scene.h"

#include <math.h>

enum { N = SCENE_CONTACTS, E = SCENE_ELEMENTS, MOST_SWEEPS = 60 };
static const double TINY = 1e-300, RHO_TOLERANCE = 2e-3;

static double larger(double a, double b) { return a > b ? a : b; }
static double smaller(double a, double b) { return a < b ? a : b; }
static double within(double x, double low, double high) { return smaller(larger(x, low), high); }
static double side(int i) { return i < SCENE_THUMB ? 1.0 : -1.0; }

double scene_smooth(double u) {
    u = within(u, 0.0, 1.0);
    return u * u * u * (10.0 + u * (6.0 * u - 15.0));
}

/* How far a contact is from where the object is flat, and how far the surface lies back there. */
static void surface(const scene_body *body, const double *sideways_m, double offset_m[2][N], double *recess_m) {
    for (int i = 0; i < N; ++i) {
        const double along = sideways_m[1] - body->at_m[1][i];
        offset_m[0][i] = sideways_m[0] - body->at_m[0][i];
        offset_m[1][i] = along - within(along, -body->straight_m, body->straight_m);
        recess_m[i] = 0.5 * body->curvature_per_m[0] * offset_m[0][i] * offset_m[0][i]
                      + 0.5 * body->curvature_per_m[1] * offset_m[1][i] * offset_m[1][i];
    }
}

void scene_rest(const scene_body *body, const double *closure_m, scene_state *state) {
    static const scene_state nothing;
    *state = nothing;
    surface(body, state->position_m + 1, state->offset_m, state->recess_m);
    for (int i = 0; i < N; ++i) {
        state->depth_m[i] = closure_m[i] - state->recess_m[i];
        for (int e = 0; e < E; ++e) state->rho[e][i] = 1.0;
    }
}

/* Adds a person's force at no velocity, and what a velocity takes off it. */
static void add_person(const scene_body *body, const scene_state *state, const scene_person *one, double dt_s,
                       double *load_n, double *drag) {
    double to_go_m[3], squares = 0.0;
    for (int k = 0; k < 3; ++k) {
        to_go_m[k] = one->target_m[k] - state->position_m[k];
        const double left_m = to_go_m[k] - state->velocity_m_s[k] * dt_s;
        squares += left_m * left_m;
    }
    const double reach_n = one->stiffness_n_per_m * sqrt(squares);
    const double share = smaller(1.0, one->cap_n / larger(reach_n, TINY));
    const double spring = share * one->stiffness_n_per_m, damper = share * one->damping_n_s_per_m;
    for (int k = 0; k < 3; ++k) {
        load_n[k] += spring * to_go_m[k] + damper * one->target_m_s[k];
        load_n[k] -= one->weight_share * body->mass_kg * body->gravity_m_s2[k];
        drag[k] += spring * dt_s + damper;
    }
}

/* The velocity along x; sets depth and normal. Trial and error decides which contacts press. */
static double normals(const scene_body *body, scene_state *state, const double *closure_m, double held_n,
                      double drag, double dt_s) {
    double sideways_m[2], offset_m[2][N], recess_m[N], stays_m[N], still_n[N], slope[N];
    for (int k = 0; k < 2; ++k) sideways_m[k] = state->position_m[1 + k] + state->velocity_m_s[1 + k] * dt_s;
    surface(body, sideways_m, offset_m, recess_m);
    for (int i = 0; i < N; ++i) {
        const double remembers = body->damping_n_s_per_m[i] / dt_s;
        stays_m[i] = closure_m[i] - recess_m[i] - side(i) * state->position_m[0];
        slope[i] = body->stiffness_n_per_m[i] + remembers;
        still_n[i] = slope[i] * stays_m[i] - remembers * larger(state->depth_m[i], 0.0);
    }
    const double mass = body->mass_kg + dt_s * drag;
    const double drive = body->mass_kg * state->velocity_m_s[0] + dt_s * held_n;
    double speed = state->velocity_m_s[0];
    int pressing[N] = {0};
    for (int sweep = 0; sweep < MOST_SWEEPS; ++sweep) {
        double push_n = 0.0, stiff = 0.0;
        int changed = sweep == 0;
        for (int i = 0; i < N; ++i) {
            const double moved_m = side(i) * (speed * dt_s);
            const int tried = still_n[i] > slope[i] * moved_m && stays_m[i] > moved_m;
            changed |= tried != pressing[i];
            pressing[i] = tried;
            push_n += tried ? side(i) * still_n[i] : 0.0;
            stiff += tried ? slope[i] : 0.0;
        }
        if (!changed) break;
        speed = (drive + dt_s * push_n) / (mass + dt_s * dt_s * stiff);
    }
    for (int i = 0; i < N; ++i) {
        const double moved_m = side(i) * (speed * dt_s);
        state->depth_m[i] = stays_m[i] - moved_m;
        state->normal_n[i] = state->depth_m[i] > 0.0 ? larger(still_n[i] - slope[i] * moved_m, 0.0) : 0.0;
    }
    return speed;
}

/* How far friction lets each element stretch (Stribeck); returns the damping of those that stick. */
static double stretch_limit(const scene_body *body, const scene_state *state, double limit_m[E][N]) {
    double stuck = 0.0;
    for (int e = 0; e < E; ++e)
        for (int i = 0; i < N; ++i) {
            const double share = state->slip_m_s[e][i] / body->stribeck_m_s;
            const double mu = body->kinetic_mu + (body->static_mu - body->kinetic_mu) / (1.0 + share * share);
            limit_m[e][i] = mu * body->pressure[e] * state->normal_n[i] / body->brush_n_per_m[i];
            if (state->slip_m_s[e][i] == 0.0 && limit_m[e][i] > 0.0) stuck += body->brush_n_per_m[i];
        }
    return body->loss_s * stuck;
}

/* One reweighting of the brushes' springs by rho, in place; returns its largest change. */
static double sweep_brushes(const scene_body *body, const scene_state *old, const double *drive, const double *mass,
                            double limit_m[E][N], double dt_s, scene_state *now) {
    double stiffness = 0.0, pull[2] = {0.0, 0.0}, change = 0.0;
    for (int e = 0; e < E; ++e)
        for (int i = 0; i < N; ++i) {
            const double spring = body->brush_n_per_m[i] * now->rho[e][i];
            stiffness += spring;
            for (int k = 0; k < 2; ++k) pull[k] += spring * old->stretch_m[k][e][i];
        }
    for (int k = 0; k < 2; ++k)
        now->velocity_m_s[1 + k] = (drive[k] - dt_s * pull[k]) / (mass[k] + dt_s * dt_s * stiffness);
    for (int e = 0; e < E; ++e)
        for (int i = 0; i < N; ++i) {
            const double y = old->stretch_m[0][e][i] + now->velocity_m_s[1] * dt_s;
            const double z = old->stretch_m[1][e][i] + now->velocity_m_s[2] * dt_s;
            const double length = sqrt(y * y + z * z);
            const double rho = smaller(1.0, limit_m[e][i] / larger(length, TINY));
            change = larger(change, fabs(rho - now->rho[e][i]));
            now->rho[e][i] = rho;
            now->stretch_m[0][e][i] = y * rho;
            now->stretch_m[1][e][i] = z * rho;
            now->slip_m_s[e][i] = length * (1.0 - rho) / dt_s;
        }
    return change;
}

static double kinetic_j(const scene_body *body, const scene_state *state) {
    double squares = 0.0;
    for (int k = 0; k < 3; ++k) squares += state->velocity_m_s[k] * state->velocity_m_s[k];
    return 0.5 * body->mass_kg * squares;
}

static double brush_j(const scene_body *body, const scene_state *state) {
    double doubled_j = 0.0;
    for (int e = 0; e < E; ++e)
        for (int i = 0; i < N; ++i) {
            const double y = state->stretch_m[0][e][i], z = state->stretch_m[1][e][i];
            doubled_j += body->brush_n_per_m[i] * (y * y + z * z);
        }
    return 0.5 * doubled_j;
}

static double normal_j(const scene_body *body, const scene_state *state, const double *closure_m) {
    double doubled_j = 0.0;
    for (int i = 0; i < N; ++i) {
        const double depth_m = larger(closure_m[i] - state->recess_m[i] - side(i) * state->position_m[0], 0.0);
        doubled_j += body->stiffness_n_per_m[i] * (depth_m * depth_m);
    }
    return 0.5 * doubled_j;
}

/* Slows a step that ended with more energy than it had and was given; see body.py. */
static void keep_the_balance(const scene_body *body, const scene_state *old, scene_state *state,
                             const double *closure_m, double given_j) {
    surface(body, state->position_m + 1, state->offset_m, state->recess_m);
    state->brush_j = brush_j(body, state);
    const double allowed_j = kinetic_j(body, old) + old->brush_j + normal_j(body, old, closure_m) + given_j;
    const double moving_j = kinetic_j(body, state);
    const double left_j = allowed_j - (state->brush_j + normal_j(body, state, closure_m));
    if (moving_j <= left_j) return;
    const double share = sqrt(larger(left_j, 0.0) / larger(moving_j, TINY));
    for (int k = 0; k < 3; ++k) state->velocity_m_s[k] *= smaller(share, 1.0);
    if (left_j >= 0.0) return;
    for (int k = 0; k < 3; ++k) state->position_m[k] = old->position_m[k];
    for (int e = 0; e < E; ++e)
        for (int i = 0; i < N; ++i)
            for (int k = 0; k < 2; ++k) state->stretch_m[k][e][i] = state->rho[e][i] * old->stretch_m[k][e][i];
    for (int i = 0; i < N; ++i) {
        for (int k = 0; k < 2; ++k) state->offset_m[k][i] = old->offset_m[k][i];
        state->recess_m[i] = old->recess_m[i];
    }
    state->brush_j = brush_j(body, state);
}

void scene_step(const scene_body *body, scene_state *state, const double *closure_m, const scene_person *people,
                int count, double dt_s) {
    const scene_state old = *state;
    double load_n[3] = {0.0}, drag[3] = {0.0}, held_n[3], limit_m[E][N], drive[2], mass[2], given_j = 0.0;
    for (int p = 0; p < count; ++p) add_person(body, &old, people + p, dt_s, load_n, drag);
    for (int k = 0; k < 3; ++k) held_n[k] = load_n[k] + body->mass_kg * body->gravity_m_s2[k];
    state->velocity_m_s[0] = normals(body, state, closure_m, held_n[0], drag[0], dt_s);
    const double stuck = stretch_limit(body, state, limit_m);
    for (int k = 0; k < 2; ++k) {
        /* a curved surface leans, so the normal force has a part along the skin */
        double leaning_n = 0.0;
        for (int i = 0; i < N; ++i) leaning_n += body->curvature_per_m[k] * old.offset_m[k][i] * state->normal_n[i];
        drive[k] = body->mass_kg * old.velocity_m_s[1 + k] + dt_s * (held_n[1 + k] + leaning_n);
        mass[k] = body->mass_kg + dt_s * (drag[1 + k] + stuck);
    }
    for (int sweep = 0; sweep <= MOST_SWEEPS; ++sweep)
        if (sweep_brushes(body, &old, drive, mass, limit_m, dt_s, state) <= RHO_TOLERANCE) break;
    for (int k = 0; k < 3; ++k) {
        const double moved_m = state->velocity_m_s[k] * dt_s, resisted_n = drag[k] * state->velocity_m_s[k];
        state->position_m[k] = old.position_m[k] + moved_m;
        state->agents_n[k] = load_n[k] - resisted_n;
        given_j += (held_n[k] - resisted_n) * moved_m;
    }
    keep_the_balance(body, &old, state, closure_m, given_j);
}

void scene_forces(const scene_body *body, const scene_state *state, double *forces_n) {
    for (int i = 0; i < N; ++i) {
        double y = 0.0, z = 0.0;
        for (int e = 0; e < E; ++e) {
            y += body->brush_n_per_m[i] * state->stretch_m[0][e][i];
            z += body->brush_n_per_m[i] * state->stretch_m[1][e][i];
        }
        forces_n[3 * i] = y;
        forces_n[3 * i + 1] = z * -side(i);
        forces_n[3 * i + 2] = state->normal_n[i];
    }
}

double scene_drive_step(scene_drive *drive, double target_n, double own_n, double dt_s) {
    const double felt_n = 0.05, felt_n_s = 0.5; /* a change that cannot be felt */
    const double wanted_n = target_n > 0.0 ? larger(target_n, own_n) : own_n;
    const int beyond = drive->motor_n - drive->own_n > felt_n || fabs(drive->speed_n_s) > felt_n_s;
    drive->own_n = own_n;
    if (wanted_n == own_n && !beyond) { /* a hand that only its wearer moves */
        drive->speed_n_s = 0.0;
        return drive->motor_n = drive->place_n = own_n;
    }
    const double ceiling_n = larger(drive->ceiling_n, own_n);
    const double rest_n = drive->motor_n + drive->lag_s * drive->speed_n_s;
    double speed = (smaller(wanted_n, ceiling_n) - rest_n) / larger(drive->lag_s, dt_s);
    speed = within(speed, -drive->fastest_n_s, drive->fastest_n_s);
    drive->speed_n_s += (drive->lag_s <= dt_s ? 1.0 : dt_s / drive->lag_s) * (speed - drive->speed_n_s);
    drive->motor_n = within(drive->motor_n + drive->speed_n_s * dt_s, own_n, ceiling_n);
    return drive->place_n = within(drive->place_n, drive->motor_n - drive->backlash_n, drive->motor_n);
}
