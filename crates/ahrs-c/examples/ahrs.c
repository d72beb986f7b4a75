/* Estimates the attitude of a recording.
 *
 * usage: ahrs < recording.csv
 *
 * The recording has a header line and the columns t_s, gyro in rad/s, specific force in m/s^2 and
 * magnetic field in microtesla; further columns are ignored. The program prints quaternion and
 * heading of each sample, with all digits. */
#include <plumbline_ahrs.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#define COLUMNS 10

/* Reads the numbers of a line. Returns 0 if there are fewer than COLUMNS. */
static int parse(const char *line, double *values) {
    int i;
    for (i = 0; i < COLUMNS; i++) {
        char *end;
        values[i] = strtod(line, &end);
        if (end == line) {
            return 0;
        }
        line = *end == ',' ? end + 1 : end;
    }
    return 1;
}

int main(void) {
    char line[1024];
    double values[COLUMNS];
    PlumblineAttitude attitude;
    PlumblineAhrs *ahrs = plumbline_ahrs_new(NULL);
    if (ahrs == NULL) {
        fprintf(stderr, "%s\n", plumbline_error_message());
        return 1;
    }
    while (fgets(line, sizeof line, stdin) != NULL) {
        const double *gyro = values + 1, *accel = values + 4, *mag = values + 7;
        const double *q = attitude.quaternion;
        if (!parse(line, values)) {
            continue; /* The header. */
        }
        if (plumbline_ahrs_update_at(ahrs, gyro, accel, mag, llround(values[0] * 1e9), &attitude) !=
            PLUMBLINE_STATUS_OK) {
            fprintf(stderr, "%s\n", plumbline_error_message());
            return 1;
        }
        printf("%.17g,%.17g,%.17g,%.17g,%.17g\n", q[0], q[1], q[2], q[3], attitude.heading_rad);
    }
    plumbline_ahrs_free(ahrs);
    return 0;
}
