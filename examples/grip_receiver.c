/* A hand's own controller: receives the commands of `holdfast run --grip URL`.
   cc -std=c99 -D_POSIX_C_SOURCE=200809L -o grip_receiver examples/grip_receiver.c
   ./grip_receiver /run/hand/grip      --grip unix:///run/hand/grip */
#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

enum { SILENT_MS = 300 };                           /* expires_ms */
static const double CEILING_N = 70, SLEW_N_S = 400; /* what this hand allows, whatever is commanded */
static const char *MODES[] = {"idle", "hold", "tighten", "relax", "yield"};

/* Which lines are obeyed: rising sequences only, until the sender is silent. */
typedef struct {
    long long sequence, obeyed_ns;
    int begun;
} rising_t;

static int lives(const rising_t *r, long long now_ns) {
    return r->begun && now_ns - r->obeyed_ns <= 1000000LL * SILENT_MS;
}

static int obeys(rising_t *r, long long sequence, long long now_ns) {
    if (lives(r, now_ns) && sequence <= r->sequence) return 0;
    r->sequence = sequence, r->obeyed_ns = now_ns, r->begun = 1;
    return 1;
}

typedef struct {
    long long sequence;
    char mode[16], reason[41];
    double target_n, slew_n_s; /* target_n < 0: the grip it has */
} command_t;

/* Where the value of a key begins, as Holdfast writes it: "key":value; NULL: it is not there. */
static const char *value_of(const char *line, const char *key) {
    const char *at = strstr(line, key);
    return at ? at + strlen(key) : NULL;
}

/* A number from 0 on, at most `most`; -1: something else. */
static double number(const char *at, double most) {
    double value;
    if (!at || !isdigit((unsigned char)*at)) return -1;
    value = strtod(at, NULL);
    return value < most ? value : most;
}

/* A text of printable ASCII without escapes; 0: something else. */
static int text(const char *at, char *to, size_t size) {
    size_t n = 0;
    if (!at || *at++ != '"') return 0;
    for (; *at && *at != '"'; ++at) {
        if (!isprint((unsigned char)*at) || *at == '\\') return 0;
        if (n + 1 < size) to[n++] = *at;
    }
    to[n] = 0;
    return *at == '"';
}

/* Whether a line of n bytes is a whole command; else it is skipped. */
static int parsed(const char *line, size_t n, command_t *c) {
    const char *target = value_of(line, "\"target_n\":");
    const double sequence = number(value_of(line, "\"sequence\":"), 9e15);
    int known = 0;
    if (n < 2 || line[0] != '{' || line[n - 1] != '}' || !target) return 0;
    if (!text(value_of(line, "\"mode\":"), c->mode, sizeof c->mode)) return 0;
    if (!text(value_of(line, "\"reason\":"), c->reason, sizeof c->reason)) return 0;
    for (int k = 0; k < 5; ++k) known |= !strcmp(c->mode, MODES[k]);
    c->sequence = (long long)sequence;
    c->target_n = number(target, CEILING_N);
    c->slew_n_s = number(value_of(line, "\"slew_n_s\":"), SLEW_N_S);
    if (c->target_n < 0 && strncmp(target, "null", 4)) return 0;
    return known && sequence >= 0 && c->slew_n_s >= 0;
}

/* Here the motor would be moved; this hand only prints. */
static void move(const char *mode, double target_n, double slew_n_s, const char *reason) {
    char grip[32] = "the grip it has";
    if (target_n >= 0) snprintf(grip, sizeof grip, "%.1f N", target_n);
    printf("%s: %s, at most %.0f N/s (%s)\n", mode, grip, slew_n_s, reason);
    fflush(stdout);
}

/* A socket at a path that only this user may write to; -1: none. */
static int listen_at(const char *where) {
    struct timeval wait = {.tv_usec = 50000};
    struct sockaddr_un path = {.sun_family = AF_UNIX};
    const int receiver = socket(AF_UNIX, SOCK_DGRAM, 0);
    setsockopt(receiver, SOL_SOCKET, SO_RCVTIMEO, &wait, sizeof wait);
    snprintf(path.sun_path, sizeof path.sun_path, "%s", where);
    unlink(where);
    fchmod(receiver, 0600); /* before bind: never wider, whatever the umask */
    return bind(receiver, (struct sockaddr *)&path, sizeof path) ? -1 : receiver;
}

static long long monotonic_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return 1000000000LL * now.tv_sec + now.tv_nsec;
}

int main(int argc, char **argv) {
    const int receiver = argc > 1 ? listen_at(argv[1]) : -1;
    rising_t rising = {0, 0, 0};
    int holds = 1;
    if (receiver < 0) return perror("listen"), 1;
    puts("listening");
    fflush(stdout);
    for (;;) {
        char line[2048];
        command_t command;
        const ssize_t n = recv(receiver, line, sizeof line - 1, 0);
        const long long now_ns = monotonic_ns();
        if (!holds && !lives(&rising, now_ns)) { /* also while others send */
            move("hold", -1, 0, "no command for 300 ms");
            holds = 1;
        }
        if (n <= 0) continue;
        line[n] = 0;
        if (!parsed(line, strlen(line), &command)) continue; /* cut off on the way, or something else */
        if (!obeys(&rising, command.sequence, now_ns)) continue;
        move(command.mode, command.target_n, command.slew_n_s, command.reason);
        holds = 0;
    }
}
