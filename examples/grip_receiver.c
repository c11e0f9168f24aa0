/* A hand's own controller: its wearer first, then the commands of `holdfast run --grip URL`.
   cc -std=c99 -D_POSIX_C_SOURCE=200809L -o grip_receiver examples/grip_receiver.c
   ./grip_receiver /run/hand/grip      --grip unix:///run/hand/grip */
#include <ctype.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#define SILENT_NS 300000000LL /* expires_ms */
#define FILTER_NS 0LL         /* 60000000LL in a hand that does not filter muscle artefacts itself */
static const double CEILING_N = 70, SLEW_N_S = 400; /* what this hand allows, whatever is commanded */
static const char *const MODES[] = {"idle", "hold", "tighten", "relax", "yield"};

typedef struct {
    char mode[16], reason[41];
    double target_n, slew_n_s; /* target_n < 0: the grip it has; where the wearer opens, the wearer's */
} command_t;
static const command_t HOLD = {"hold", "no command for 300 ms", -1, 0}, OPEN = {"open", "the wearer opens", -1, 400};

typedef struct {
    long long newest, silent_ns, opens_ns, filter_ns;
    command_t command;
    int opened;
} receiver_t;
static const receiver_t BEGIN = {.newest = -1, .silent_ns = -1, .opens_ns = -1, .filter_ns = FILTER_NS};

/* To fill in: what the wearer commands now. Here the first letter of a line: open, close, stop, empty. */
static int wearer(int word) {
    struct pollfd typed = {.fd = 0, .events = POLLIN};
    char line[64];
    return poll(&typed, 1, 0) > 0 && read(0, line, sizeof line) > 0 ? line[0] : word;
}

/* To fill in: here the motor would be moved; this hand only prints what is new. */
static void move(const command_t *to) {
    static char before[128] = "hold: the grip it has, at most 0 N/s (no command for 300 ms)";
    char grip[32] = "the grip it has", now[128];
    if (to->target_n >= 0) snprintf(grip, sizeof grip, "%.1f N", to->target_n);
    if (to == &OPEN) strcpy(grip, "the wearer's grip");
    snprintf(now, sizeof now, "%s: %s, at most %.0f N/s (%s)", to->mode, grip, to->slew_n_s, to->reason);
    if (strcmp(now, before)) puts(strcpy(before, now)), fflush(stdout);
}

/* The sequence of a line, which is a whole command as Holdfast writes it; -1: a line to skip. */
static long long parsed(const char *line, command_t *c) {
    long long sequence;
    char target[24], *end;
    int at = 0, known = 0, k = 0;
    sscanf(line, "{\"sequence\":%16lld,\"t_ns\":%*[0-9],\"mode\":\"%15[a-z]\",\"target_n\":%23[^,],\"slew_n_s\":%lf,"
                 "\"feedback\":%*[^,],\"reason\":\"%n", &sequence, c->mode, target, &c->slew_n_s, &at);
    if (!at || line[strlen(line) - 1] != '}') return -1; /* cut off on the way, or something else */
    while (isprint((unsigned char)line[at + k]) && !strchr("\"\\", line[at + k])) ++k;
    snprintf(c->reason, sizeof c->reason, "%.*s", k, line + at);
    for (int m = 0; m < 5; ++m) known |= !strcmp(c->mode, MODES[m]);
    c->target_n = strtod(target, &end);
    if (!known || line[at + k] != '"' || !(c->slew_n_s >= 0 && c->slew_n_s < 1e300)) return -1;
    if (strcmp(target, "null") && (end == target || *end || !(c->target_n >= 0 && c->target_n < 1e300))) return -1;
    c->target_n = strcmp(target, "null") ? (c->target_n < CEILING_N ? c->target_n : CEILING_N) : -1;
    c->slew_n_s = c->slew_n_s < SLEW_N_S ? c->slew_n_s : SLEW_N_S;
    return sequence;
}

/* What the motor does at a sample. line: "" where none came. word: of wearer. */
static const command_t *answer(receiver_t *r, const char *line, int word, long long now_ns) {
    command_t command;
    if (now_ns > r->silent_ns) r->newest = -1, r->command = HOLD; /* also while others send */
    const long long sequence = parsed(line, &command);
    if (sequence > r->newest) r->newest = sequence, r->command = command, r->silent_ns = now_ns + SILENT_NS;
    if (word == 'o' && now_ns >= r->opens_ns) r->opened = 1; /* until the hand was empty, or the wearer closes */
    if (word == 'c' || word == 'e') r->opened = 0;
    if (word != 'o') r->opens_ns = now_ns + r->filter_ns;
    return r->opened ? &OPEN : &r->command;
}

/* Answers at each sample: when a line comes, and every 10 ms without one. */
int main(int argc, char **argv) {
    struct pollfd link = {.fd = socket(AF_UNIX, SOCK_DGRAM, 0), .events = POLLIN};
    struct sockaddr_un path = {.sun_family = AF_UNIX};
    receiver_t own = BEGIN;
    snprintf(path.sun_path, sizeof path.sun_path, "%s", argc > 1 ? argv[1] : "");
    unlink(path.sun_path);
    fchmod(link.fd, 0600); /* before bind: for this user, whatever the umask */
    if (bind(link.fd, (struct sockaddr *)&path, sizeof path)) return perror("listen"), 1;
    puts("listening"), fflush(stdout);
    for (int word = 's';;) {
        char line[2048];
        struct timespec now;
        const ssize_t n = poll(&link, 1, 10) > 0 ? recv(link.fd, line, sizeof line - 1, 0) : 0;
        line[n > 0 ? n : 0] = 0;
        clock_gettime(CLOCK_MONOTONIC, &now);
        word = wearer(word);
        move(answer(&own, line, word, 1000000000LL * now.tv_sec + now.tv_nsec));
    }
}
