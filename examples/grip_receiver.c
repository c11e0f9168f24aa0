/* A hand's own controller: its wearer first, then the commands of `holdfast run --grip URL`.
   cc -std=c99 -D_POSIX_C_SOURCE=200809L -o grip_receiver examples/grip_receiver.c
   ./grip_receiver /run/hand/grip      --grip unix:///run/hand/grip
   ./grip_receiver /dev/ttyS1          --grip serial:///dev/ttyUSB0 */
#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#define SILENT_NS 300000000LL  /* expires_ms */
#define LATE_NS 200000000LL    /* the same over a wire, on which the fastest line takes up to 100 ms */
#define RESTART_NS 100000000LL /* where t_ns falls by more, the clock of the sender has begun anew */
#define DRIFT 0.006            /* the clocks of two machines part by at most 6 ms a second */
#define FILTER_NS 0LL          /* 60000000LL in a hand that does not filter muscle artefacts itself */
#define BAUD B115200           /* of a serial port, as in --grip "serial:///dev/ttyUSB0?baud=115200" */
#ifdef CLOCK_BOOTTIME
#define CLOCK CLOCK_BOOTTIME /* that of t_ns */
#else
#define CLOCK CLOCK_MONOTONIC
#endif
static const double CEILING_N = 70, SLEW_N_S = 400; /* what this hand allows, whatever is commanded */
static const char *const MODES[] = {"idle", "hold", "tighten", "relax", "yield"};

typedef struct {
    char mode[16], reason[41];
    double target_n, slew_n_s; /* target_n < 0: the grip it has; where the wearer opens, the wearer's */
    long long sequence, t_ns;
} command_t;
static const command_t HOLD = {"hold", "no command for 300 ms", -1, 0, -1, 0};
static const command_t OPEN = {"open", "the wearer opens", -1, 400, -1, 0};

typedef struct {
    long long newest, silent_ns, opens_ns, filter_ns;
    command_t command;
    int opened, has_told;
    /* of a serial port, see is_old */
    int is_wire, has_begun;
    long long fastest_ns, newest_ns, came_ns, begins_ns;
} receiver_t;
static const receiver_t BEGIN = {.newest = -1, .silent_ns = -1, .opens_ns = -1, .filter_ns = FILTER_NS};

/* To fill in: the next new word of the wearer, 0 for none. Here the first letter of a line: open, close, stop, empty. */
static int wearer(void) {
    static int first, is_inside;
    struct pollfd typed = {.fd = 0, .events = POLLIN};
    for (char c; poll(&typed, 1, 0) > 0 && read(0, &c, 1) == 1;) {
        if (!is_inside) first = c;
        is_inside = c != '\n';
        if (!is_inside && first != '\n') return first;
    }
    return 0;
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

/* A number from 0 on, and where it ends; -1 for none. Not by strtod, which in some locales reads 9,4 and not 9.4. */
static double number(const char *text, const char **end) {
    double value = 0, scale = 1;
    int exponent = 0;
    *end = text;
    if (!isdigit((unsigned char)*text)) return -1;
    for (; isdigit((unsigned char)*text); ++text) value = 10 * value + (*text - '0');
    if (*text == '.')
        for (++text; isdigit((unsigned char)*text); ++text) value += (*text - '0') * (scale /= 10);
    if ((*text == 'e' || *text == 'E') && sscanf(text + 1, "%4d", &exponent) == 1) {
        for (text += 2; isdigit((unsigned char)*text);) ++text;
        for (; exponent > 0 && value < 1e300; --exponent) value *= 10;
        for (; exponent < 0 && value > 0; ++exponent) value /= 10;
    }
    *end = text;
    return value < 1e300 ? value : -1;
}

/* Whether a line is a whole command as Holdfast writes it. */
static int is_command(const char *line, command_t *c) {
    char target[24], slew[24];
    const char *end;
    int at = 0, known = 0, k = 0;
    sscanf(line, "{\"sequence\":%16lld,\"t_ns\":%18lld,\"mode\":\"%15[a-z]\",\"target_n\":%23[^,],\"slew_n_s\":%23[^,],"
                 "\"feedback\":%*[^,],\"reason\":\"%n", &c->sequence, &c->t_ns, c->mode, target, slew, &at);
    if (!at || line[strlen(line) - 1] != '}') return 0; /* cut off on the way, or something else */
    while (isprint((unsigned char)line[at + k]) && !strchr("\"\\", line[at + k])) ++k;
    snprintf(c->reason, sizeof c->reason, "%.*s", k, line + at);
    for (int m = 0; m < 5; ++m) known |= !strcmp(c->mode, MODES[m]);
    if (!known || line[at + k] != '"' || c->sequence < 0 || c->t_ns < 0) return 0;
    c->slew_n_s = number(slew, &end);
    if (c->slew_n_s < 0 || *end) return 0;
    c->target_n = number(target, &end);
    if (strcmp(target, "null") && (c->target_n < 0 || *end)) return 0;
    c->target_n = c->target_n < CEILING_N ? c->target_n : CEILING_N;
    c->slew_n_s = c->slew_n_s < SLEW_N_S ? c->slew_n_s : SLEW_N_S;
    return 1;
}

/* Whether a line is too old to be obeyed, or its age is unknown. From the same machine its stamp is of this
   clock. Over a wire the sender has another one: a line is as old as it is later than the fastest, which is found in
   the first 300 ms. A delay that every line has from the first on is not seen, nor one that stands for minutes. */
static int is_old(receiver_t *r, long long t_ns, long long now_ns) {
    const long long lag_ns = now_ns - t_ns;
    if (!r->is_wire) return llabs(lag_ns) > SILENT_NS;
    const long long risen_ns = r->fastest_ns + (long long)(DRIFT * (double)(now_ns - r->came_ns));
    if (!r->has_begun || t_ns < r->newest_ns - RESTART_NS)
        r->has_begun = 1, r->fastest_ns = lag_ns, r->begins_ns = now_ns + SILENT_NS;
    else
        r->fastest_ns = lag_ns < risen_ns ? lag_ns : risen_ns;
    r->newest_ns = t_ns, r->came_ns = now_ns;
    return now_ns < r->begins_ns || lag_ns - r->fastest_ns > LATE_NS;
}

/* What the motor does at a sample. line: "" where none came. word: of wearer. */
static const command_t *answer(receiver_t *r, const char *line, int word, long long now_ns) {
    command_t command;
    if (now_ns > r->silent_ns) r->newest = -1, r->command = HOLD; /* also while others send */
    if (is_command(line, &command)) {
        if (is_old(r, command.t_ns, now_ns)) {
            if (!r->has_told) fputs("lines of over 300 ms, or of another clock, are skipped\n", stderr);
            r->has_told = 1; /* a log must not fill */
        } else if (command.sequence > r->newest)
            r->newest = command.sequence, r->command = command, r->silent_ns = now_ns + SILENT_NS;
    }
    if (word == 'o' && now_ns >= r->opens_ns) r->opened = 1; /* until the hand was empty, or the wearer closes */
    if (word == 'c' || word == 'e') r->opened = 0;
    if (word != 'o') r->opens_ns = now_ns + r->filter_ns;
    return r->opened ? &OPEN : &r->command;
}

/* A serial port that passes bytes as they are; -1 with errno. */
static int opened(const char *path) {
    const int port = open(path, O_RDWR | O_NOCTTY | O_NONBLOCK);
    struct termios raw = {.c_cflag = CS8 | CREAD | CLOCAL, .c_cc[VMIN] = 1};
    cfsetispeed(&raw, BAUD), cfsetospeed(&raw, BAUD);
    return port >= 0 && tcsetattr(port, TCSANOW, &raw) ? -1 : port;
}

/* A socket at a path that only this user may write to; -1 with errno. No other file is removed. */
static int listening(const char *at) {
    const int link = socket(AF_UNIX, SOCK_DGRAM, 0);
    struct sockaddr_un path = {.sun_family = AF_UNIX};
    struct stat is;
    if (strlen(at) >= sizeof path.sun_path) return errno = ENAMETOOLONG, -1;
    strcpy(path.sun_path, at);
    /* left behind by a program that ended; where one lives, bind fails */
    if (!lstat(at, &is) && S_ISSOCK(is.st_mode) && connect(link, (struct sockaddr *)&path, sizeof path) &&
        errno == ECONNREFUSED)
        unlink(at);
    fchmod(link, 0600); /* before bind: for this user, whatever the umask */
    return bind(link, (struct sockaddr *)&path, sizeof path) ? -1 : link;
}

/* The next whole line, waiting at most so long for it; "" for none. A datagram is one line. */
static const char *next_line(receiver_t *r, struct pollfd *link, const char *path, int wait_ms) {
    static char line[2048];
    static size_t length;
    const int is_ready = poll(link, 1, wait_ms) > 0;
    if (!r->is_wire) {
        const ssize_t n = is_ready ? recv(link->fd, line, sizeof line - 1, 0) : 0;
        line[n > 0 ? n : 0] = 0;
        return line;
    }
    for (char c; is_ready;) {
        const ssize_t n = read(link->fd, &c, 1);
        if (n < 0 && errno == EAGAIN) break;
        if (n <= 0) { /* unplugged: it comes back, perhaps with another sender */
            const int again = (poll(0, 0, wait_ms), opened(path));
            if (again >= 0) close(link->fd), link->fd = again, r->has_begun = 0;
            length = 0;
            break;
        }
        if (c != '\n') {
            if (length < sizeof line - 1) line[length++] = c;
            continue;
        }
        line[length] = 0, length = 0;
        if (*line) return line;
    }
    return "";
}

static long long clock_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK, &now);
    return 1000000000LL * now.tv_sec + now.tv_nsec;
}

/* Answers at each sample: when a line comes, and every 10 ms without one. */
int main(int argc, char **argv) {
    const char *path = argc > 1 ? argv[1] : "";
    struct stat is;
    receiver_t own = BEGIN;
    own.is_wire = !stat(path, &is) && S_ISCHR(is.st_mode);
    struct pollfd link = {.fd = own.is_wire ? opened(path) : listening(path), .events = POLLIN};
    if (link.fd < 0) return perror(path), 1;
    while (*next_line(&own, &link, path, 0)) continue; /* its age is unknown */
    puts("listening"), fflush(stdout);
    for (int word = 's', next;;) {
        const long long began_ns = clock_ns();
        const char *line = next_line(&own, &link, path, 10);
        const long long now_ns = clock_ns();
        if (now_ns - began_ns > SILENT_NS) /* this program was stopped: what waited is old */
            while (*line) line = next_line(&own, &link, path, 0);
        while ((next = wearer())) move(answer(&own, "", word = next, now_ns));
        move(answer(&own, line, word, now_ns));
    }
}
