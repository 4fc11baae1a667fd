/* Sine, cosine and arc tangent by their series: those of C libraries differ in the last bit from one
 * library or processor to another. */
#pragma once

#include <math.h>

#define HALF_PI_HIGH 1.5707963267948966
#define HALF_PI_LOW 6.123233995736766e-17
#define TAU 6.283185307179586

typedef struct {
    double c, s;
} Turn;

/* Cosine and sine of an angle of at most pi / 4, to 1e-17. */
static inline Turn turn_by_small(double a) {
    double q = a * a;
    double c = 1 - q / 2 * (1 - q / 12 * (1 - q / 30 * (1 - q / 56 * (1 - q / 90 * (
               1 - q / 132 * (1 - q / 182 * (1 - q / 240)))))));
    double s = a * (1 - q / 6 * (1 - q / 20 * (1 - q / 42 * (1 - q / 72 * (1 - q / 110 * (
               1 - q / 156 * (1 - q / 210)))))));
    return (Turn){c, s};
}

static inline Turn turn_by(double angle) {
    double quarters = floor(angle / HALF_PI_HIGH + 0.5);
    double rest = (angle - quarters * HALF_PI_HIGH) - quarters * HALF_PI_LOW;
    Turn t = turn_by_small(rest);
    int quarter = (int)(quarters - 4 * floor(quarters / 4));
    switch (quarter) {
    case 0: return t;
    case 1: return (Turn){-t.s, t.c};
    case 2: return (Turn){-t.c, -t.s};
    default: return (Turn){t.s, -t.c};
    }
}

#define SMALL_TURN 0.03

/* Add the small angle `a` to the turn `t`: exact to 1e-12 up to SMALL_TURN. */

static inline Turn turn_further(Turn t, double a) {
    double q = a * a;
    double c = 1 - q * (1.0 / 2 - q * (1.0 / 24 - q * (1.0 / 720)));
    double s = a * (1 - q * (1.0 / 6 - q * (1.0 / 120 - q * (1.0 / 5040))));
    return (Turn){t.c * c - t.s * s, t.s * c + t.c * s};
}

/* Angle of the direction (c, s), in (-pi, pi], 0 for none; without branches. */
static inline double angle_of(double c, double s) {
    double ahead = fabs(c), aside = fabs(s);
    double low = ahead < aside ? ahead : aside, high = ahead < aside ? aside : ahead;
    double whole = sqrt(c * c + s * s) + high;
    double t = low / (whole > 0 ? whole : 1);       /* tan of half the angle */
    t = t / (1 + sqrt(1 + t * t));                  /* tan of a quarter: <= 0.2 */
    double q = t * t, series = 0;
    for (int k = 23; k >= 1; k -= 2) series = 1.0 / k - q * series;
    double angle = 4 * t * series;
    angle = ahead < aside ? HALF_PI_HIGH - angle : angle;
    angle = c < 0 ? 2 * HALF_PI_HIGH - angle : angle;
    return s < 0 ? -angle : angle;
}
