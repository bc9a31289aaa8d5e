/* The same closed loop in plain C: two plants, a pair of PID controllers, one loop after the other in each thread.
 *
 * plant: z' = P z + g u for (temperature, displacement, velocity), P lower triangular in blocks, as in
 * scpjax/control/plant.py; controller: thesis (3.16)-(3.18) with forward Euler, as in scpjax/control/pid.py.
 *
 * gcc -O3 -march=native -shared -fPIC -pthread control.c -o control.so
 */
#include <math.h>
#include <pthread.h>

typedef struct {
    const double *gains; /* loops x 4: Kp Ki Kd N */
    const double *plant; /* p00 p10 p11 p12 p20 p21 p22 g0 g1 g2 scale high dt */
    const double *reference;
    double *rmse;
    long first, last, steps;
} Work;

typedef struct {
    double t, x, v, integral, filtered;
} Side;

static inline double control(Side *s, double sign, double e, const double *k, double high, double dt)
{
    double push = dt * sign * k[1] * e;
    double derivative = k[3] * (sign * k[2] * e - s->filtered);
    double asked = sign * k[0] * e + s->integral + derivative;
    double effort = asked < 0.0 ? 0.0 : asked > high ? high : asked;
    if (!(asked != effort && push * asked > 0.0)) s->integral += push;
    s->filtered += dt * derivative;
    return effort;
}

static inline void advance(Side *s, const double *p, double u)
{
    double t = p[0] * s->t + p[7] * u;
    double x = p[1] * s->t + p[2] * s->x + p[3] * s->v + p[8] * u;
    double v = p[4] * s->t + p[5] * s->x + p[6] * s->v + p[9] * u;
    s->t = t, s->x = x, s->v = v;
}

static void *work(void *given)
{
    Work *w = given;
    const double *p = w->plant;
    for (long i = w->first; i < w->last; i++) {
        Side a = {0}, b = {0};
        double sum = 0.0;
        for (long k = 0; k < w->steps; k++) {
            double e = w->reference[k] - (a.x - b.x) * p[10];
            sum += e * e;
            double ua = control(&a, 1.0, e, w->gains + 4 * i, p[11], p[12]);
            double ub = control(&b, -1.0, e, w->gains + 4 * i, p[11], p[12]);
            advance(&a, p, ua);
            advance(&b, p, ub);
        }
        w->rmse[i] = sqrt(sum / w->steps);
    }
    return 0;
}

void loops(const double *gains, const double *plant, const double *reference, double *rmse, long n, long steps,
           long threads)
{
    pthread_t thread[64];
    Work share[64];
    for (long t = 0; t < threads; t++) {
        share[t] = (Work){gains, plant, reference, rmse, n * t / threads, n * (t + 1) / threads, steps};
        pthread_create(&thread[t], 0, work, &share[t]);
    }
    for (long t = 0; t < threads; t++) pthread_join(thread[t], 0);
}
