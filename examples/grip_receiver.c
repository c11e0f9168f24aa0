/* A hand's own controller: receives the commands of `holdfast run --grip udp://127.0.0.1:9000`.
   cc -std=c99 -D_POSIX_C_SOURCE=200809L -o grip_receiver examples/grip_receiver.c && ./grip_receiver 9000 */
#include <arpa/inet.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>

static const char *value(const char *line, const char *key) {
    const char *at = strstr(line, key);
    return at ? at + strlen(key) : "";
}

/* Here the motor would be moved; this hand only prints. target_n < 0: the grip it has. */
static void move(const char *mode, double target_n, double slew_n_s, const char *reason) {
    char grip[32] = "the grip it has";
    if (target_n >= 0) snprintf(grip, sizeof grip, "%.1f N", target_n);
    printf("%s: %s, at most %.0f N/s (%s)\n", mode, grip, slew_n_s, reason);
    fflush(stdout);
}

int main(int argc, char **argv) {
    int receiver = socket(AF_INET, SOCK_DGRAM, 0), silent = 1;
    long long newest_ns = -1;
    struct timeval expires = {.tv_usec = 300000};
    struct sockaddr_in own = {.sin_family = AF_INET, .sin_port = htons(argc > 1 ? atoi(argv[1]) : 9000)};
    own.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    setsockopt(receiver, SOL_SOCKET, SO_RCVTIMEO, &expires, sizeof expires);
    if (bind(receiver, (struct sockaddr *)&own, sizeof own)) return perror("bind"), 1;
    puts("listening");
    fflush(stdout);
    for (;;) {
        char line[2048], mode[16], reason[64];
        ssize_t n = recv(receiver, line, sizeof line - 1, 0);
        if (n < 0) { /* no command for expires_ms */
            if (!silent) move("hold", -1, 0, "no command for 300 ms");
            newest_ns = -1, silent = 1;
            continue;
        }
        line[n] = 0;
        long long t_ns = atoll(value(line, "\"t_ns\":"));
        if (sscanf(value(line, "\"mode\":\""), "%15[a-z]", mode) != 1) continue; /* cut off on the way */
        if (sscanf(value(line, "\"reason\":\""), "%63[^\"]", reason) != 1) continue;
        if (t_ns <= newest_ns) continue; /* overtaken on the way */
        newest_ns = t_ns, silent = 0;
        const char *target = value(line, "\"target_n\":");
        move(mode, *target == 'n' ? -1 : atof(target), atof(value(line, "\"slew_n_s\":")), reason);
    }
}
