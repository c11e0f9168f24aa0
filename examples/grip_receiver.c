/* A hand's own controller: receives the commands of `holdfast run --grip URL`.
   cc -std=c99 -D_POSIX_C_SOURCE=200809L -o grip_receiver examples/grip_receiver.c -lm
   ./grip_receiver /run/hand/grip      --grip unix:///run/hand/grip
   ./grip_receiver 9000                --grip udp://127.0.0.1:9000
   ./grip_receiver 9000 link.key       --grip "udp://127.0.0.1:9000?key=link.key" */
#include <arpa/inet.h>
#include <ctype.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#include "hmac_sha256.h"

enum { RATE_HZ = 150, SILENT_MS = 300 };             /* a second of samples; expires_ms */
static const double CEILING_N = 70, SLEW_N_S = 400; /* what this hand allows, whatever is commanded */
static const char *MODES[] = {"idle", "hold", "tighten", "relax", "yield"};

/* Which lines are obeyed: of one session until it is silent, and rising numbers only.
   keyed: nothing up to the newest (session, sequence) is obeyed again. */
typedef struct {
    long long session, sequence, obeyed_ns;
    int keyed, begun;
} session_t;

static int lives(const session_t *s, long long now_ns) {
    return s->begun && now_ns - s->obeyed_ns <= 1000000LL * SILENT_MS;
}

static int obeys(session_t *s, long long session, long long sequence, long long now_ns) {
    const long long ahead = sequence - s->sequence;
    const int is_newer = session > s->session || (session == s->session && ahead > 0);
    const int follows = session == s->session && ahead > 0 && ahead <= RATE_HZ;
    if (lives(s, now_ns) ? !follows : s->keyed && !is_newer) return 0;
    s->session = session, s->sequence = sequence, s->obeyed_ns = now_ns, s->begun = 1;
    return 1;
}

/* Behind the blanks, the digits, or a text in quotes (ASCII, as all lines of Holdfast are); NULL: none. */
static const char *past_blanks(const char *at) { return at + strspn(at, " \t\r\n"); }

static const char *past_digits(const char *at) {
    const size_t n = at ? strspn(at, "0123456789") : 0;
    return n ? at + n : NULL;
}

static const char *past_text(const char *at) {
    if (*at != '"') return NULL;
    while (*++at != '"') {
        if (*at == '\\') ++at;
        if (!isprint((unsigned char)*at)) return NULL;
    }
    return at + 1;
}

/* Behind a text, a number or a word of JSON. NULL: anything else, also a list or an object. */
static const char *past_value(const char *at) {
    static const char *WORDS[] = {"null", "true", "false"};
    const char *end;
    if (*at == '"') return past_text(at);
    for (int k = 0; k < 3; ++k)
        if (!strncmp(at, WORDS[k], strlen(WORDS[k]))) return at + strlen(WORDS[k]);
    end = at + (*at == '-');
    end = *end == '0' ? end + 1 : past_digits(end);
    if (end && *end == '.') end = past_digits(end + 1);
    if (end && (*end == 'e' || *end == 'E')) end = past_digits(end + 1 + (end[1] == '-' || end[1] == '+'));
    return end && isfinite(strtod(at, NULL)) ? end : NULL;
}

enum { SESSION, SEQUENCE, MODE, TARGET_N, SPEED, REASON, NAMES, MOST_MEMBERS = 32 };
static const char *KEYS[] = {"\"session\"", "\"sequence\"", "\"mode\"", "\"target_n\"", "\"slew_n_s\"", "\"reason\""};

/* Finds the values of KEYS. Whether the line is one JSON object of plain values, each key once, and has them all. */
static int members(const char *at, const char *values[NAMES]) {
    const char *keys[MOST_MEMBERS], *end;
    size_t sizes[MOST_MEMBERS];
    int n = 0, found = 0;
    do {
        if (n == MOST_MEMBERS || *at != (n ? ',' : '{')) return 0;
        keys[n] = past_blanks(at + 1);
        if (!(end = past_text(keys[n]))) return 0;
        sizes[n] = (size_t)(end - keys[n]);
        if (memchr(keys[n], '\\', sizes[n])) return 0; /* another way to write the same key */
        for (int k = 0; k < n; ++k)
            if (sizes[k] == sizes[n] && !memcmp(keys[k], keys[n], sizes[n])) return 0;
        end = past_blanks(end);
        if (*end != ':') return 0;
        at = past_blanks(end + 1);
        for (int k = 0; k < NAMES; ++k)
            if (strlen(KEYS[k]) == sizes[n] && !memcmp(KEYS[k], keys[n], sizes[n])) values[k] = at, ++found;
        if (!(end = past_value(at))) return 0;
        at = past_blanks(end);
        ++n;
    } while (*at != '}');
    return found == NAMES && !*past_blanks(at + 1);
}

/* A whole number from 0 to 2^53 - 1, or -1. */
static long long whole(const char *at) {
    long long number = 0;
    const char *end = past_digits(at);
    if (!end || *end == '.' || *end == 'e' || *end == 'E') return -1;
    for (; at < end; ++at)
        if ((number = 10 * number + (*at - '0')) > 9007199254740991LL) return -1;
    return number;
}

/* A number from 0 on, at most `most`; -1 for null, -2 for anything else. */
static double number(const char *at, double most) {
    if (*at == 'n') return -1;
    if (!isdigit((unsigned char)*at)) return -2; /* also -0 */
    return fmin(strtod(at, NULL), most);
}

/* Takes the code from the end of a line of n bytes. Whether it is right. */
static int opened(char *line, size_t n, const char *key) {
    enum { TAIL = 74 }; /* ,"mac":" and 64 digits and "} */
    uint8_t code[32];
    char right[TAIL + 1] = ",\"mac\":\"";
    unsigned differs = 0;
    if (n <= TAIL) return 0;
    hmac_sha256(key, "grip\n", line, n - TAIL, code);
    for (int k = 0; k < 32; ++k) sprintf(right + 8 + 2 * k, "%02x", code[k]);
    strcat(right, "\"}");
    /* all of it, so that the time tells nothing about where it differs */
    for (int k = 0; k < TAIL; ++k) differs |= (unsigned char)(line[n - TAIL + k] ^ right[k]);
    strcpy(line + n - TAIL, "}");
    return !differs;
}

typedef struct {
    long long session, sequence;
    char mode[16], reason[41];
    double target_n, slew_n_s; /* target_n < 0: the grip it has */
} command_t;

/* Whether a line is a whole command; else it is skipped. */
static int parsed(const char *line, command_t *c) {
    const char *values[NAMES];
    int known = 0;
    if (!members(past_blanks(line), values)) return 0;
    if (sscanf(values[REASON], "\"%40[^\"]", c->reason) != 1 || strchr(c->reason, '\\')) return 0;
    for (int k = 0; k < 5; ++k) {
        const size_t n = strlen(MODES[k]);
        if (*values[MODE] != '"' || strncmp(values[MODE] + 1, MODES[k], n) || values[MODE][n + 1] != '"') continue;
        strcpy(c->mode, MODES[k]);
        known = 1;
    }
    c->session = whole(values[SESSION]);
    c->sequence = whole(values[SEQUENCE]);
    c->target_n = number(values[TARGET_N], CEILING_N);
    c->slew_n_s = number(values[SPEED], SLEW_N_S);
    return known && c->session >= 0 && c->sequence >= 0 && c->target_n > -2 && c->slew_n_s >= 0;
}

/* Here the motor would be moved; this hand only prints. */
static void move(const char *mode, double target_n, double slew_n_s, const char *reason) {
    char grip[32] = "the grip it has";
    if (target_n >= 0) snprintf(grip, sizeof grip, "%.1f N", target_n);
    printf("%s: %s, at most %.0f N/s (%s)\n", mode, grip, slew_n_s, reason);
    fflush(stdout);
}

/* A socket at a path that only this user may write to, or at a port of this machine; -1: none. */
static int listen_at(const char *where) {
    struct timeval wait = {.tv_usec = 50000};
    struct sockaddr_un path = {.sun_family = AF_UNIX};
    struct sockaddr_in port = {.sin_family = AF_INET};
    const int is_path = *where == '/';
    const int receiver = socket(is_path ? AF_UNIX : AF_INET, SOCK_DGRAM, 0);
    setsockopt(receiver, SOL_SOCKET, SO_RCVTIMEO, &wait, sizeof wait);
    if (!is_path) {
        port.sin_port = htons((uint16_t)atoi(where));
        port.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        return bind(receiver, (struct sockaddr *)&port, sizeof port) ? -1 : receiver;
    }
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

/* The newest session outlives a restart: here in a file, on a board in its flash. */
static long long stored(const char *path) {
    FILE *file = fopen(path, "r");
    long long session = 0;
    if (file && fscanf(file, "%lld", &session) != 1) session = 0;
    if (file) fclose(file);
    return session;
}

static void store(const char *path, long long session) {
    char whole_path[300];
    FILE *file;
    snprintf(whole_path, sizeof whole_path, "%s.new", path);
    if (!(file = fopen(whole_path, "w"))) return;
    fprintf(file, "%lld", session);
    if (!fclose(file)) rename(whole_path, path);
}

int main(int argc, char **argv) {
    const int receiver = listen_at(argc > 1 ? argv[1] : "9000");
    char key[65] = "", seen[256];
    session_t session = {0, -1, 0, argc > 2, 0};
    int holds = 1;
    if (session.keyed) {
        FILE *file = fopen(argv[2], "r");
        if (!file || fscanf(file, "%64s", key) != 1 || strlen(key) < 32) return fputs("no key\n", stderr), 1;
        fclose(file);
        snprintf(seen, sizeof seen, "%s.grip.seen", argv[2]);
        session.session = stored(seen);
    }
    if (receiver < 0) return perror("listen"), 1;
    puts("listening");
    fflush(stdout);
    for (;;) {
        char line[2048];
        command_t command;
        const ssize_t n = recv(receiver, line, sizeof line - 1, 0);
        const long long now_ns = monotonic_ns(), before = session.session;
        if (!holds && !lives(&session, now_ns)) { /* also while others send */
            move("hold", -1, 0, "no command for 300 ms");
            holds = 1;
        }
        if (n <= 0 || memchr(line, 0, (size_t)n)) continue;
        line[n] = 0;
        if (session.keyed && !opened(line, (size_t)n, key)) continue;
        if (!parsed(line, &command)) continue; /* cut off on the way, forged, or something else */
        if (!obeys(&session, command.session, command.sequence, now_ns)) continue;
        if (session.keyed && session.session != before) store(seen, session.session);
        move(command.mode, command.target_n, command.slew_n_s, command.reason);
        holds = 0;
    }
}
