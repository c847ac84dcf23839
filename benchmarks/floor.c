/* The same work as the kernels, written in C without a library: the floor that they are held
 * against. Compiled for this machine when a benchmark runs; see floor.py. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#define BLOCK 256

/* The likelihood field: carry each beam's end into the map, read a 16-bit code, sum. */
void summed_codes(const double *poses, int64_t n, const float *hits, int64_t beams,
                  const uint16_t *codes, int64_t rows, int64_t cols, double per_m, uint32_t *sums)
{
    float x[BLOCK], y[BLOCK], c[BLOCK], s[BLOCK];
    int32_t cell[BLOCK];
    const float last_x = cols - 0.5f, last_y = rows - 0.5f;
    for (int64_t start = 0; start < n; start += BLOCK) {
        const int m = n - start < BLOCK ? (int)(n - start) : BLOCK;
        uint32_t total[BLOCK] = {0};
        for (int i = 0; i < m; i++) {
            const double *pose = poses + 3 * (start + i);
            x[i] = (float)(pose[0] * per_m + 1.0);
            y[i] = (float)(pose[1] * per_m + 1.0);
            c[i] = cosf((float)pose[2]);
            s[i] = sinf((float)pose[2]);
        }
        for (int64_t beam = 0; beam < beams; beam++) {
            const float along = hits[2 * beam], across = hits[2 * beam + 1];
            for (int i = 0; i < m; i++) {
                float col = x[i] + c[i] * along - s[i] * across;
                float row = y[i] + s[i] * along + c[i] * across;
                col = col < last_x ? col : last_x;
                row = row < last_y ? row : last_y;
                col = col > 0.0f ? col : 0.0f;
                row = row > 0.0f ? row : 0.0f;
                cell[i] = (int32_t)row * (int32_t)cols + (int32_t)col;
            }
            for (int i = 0; i < m; i++)
                total[i] += codes[cell[i]];
        }
        for (int i = 0; i < m; i++)
            sums[start + i] = total[i];
    }
}

/* Drive along a bearing, with noise that is given (omnidirectional). */
void drive(const double *poses, int64_t n, const float *noise, const double *motion, double *moved)
{
    const double bearing = motion[0], drive = motion[1], turn = motion[2];
    for (int64_t i = 0; i < n; i++) {
        const float direction = (float)(poses[3 * i + 2] + bearing);
        const double c = cosf(direction), s = sinf(direction);
        const double along = drive + motion[3] * noise[i], across = motion[4] * noise[n + i];
        const double heading = poses[3 * i + 2] + turn + motion[5] * noise[2 * n + i];
        moved[3 * i] = poses[3 * i] + along * c - across * s;
        moved[3 * i + 1] = poses[3 * i + 1] + along * s + across * c;
        moved[3 * i + 2] = heading - 2.0 * M_PI * floor((heading + M_PI) / (2.0 * M_PI));
    }
}

/* Systematic resampling of weights that sum to one. */
void pick(const double *weights, int64_t n, double first, int64_t *picked)
{
    int64_t j = 0;
    double end = weights[0];
    for (int64_t i = 0; i < n; i++) {
        const double position = (i + first) / n;
        while (end <= position && j < n - 1)
            end += weights[++j];
        picked[i] = j;
    }
}

/* One ray, in cells, over squares that lie ahead (see clustermcl/filter/laser/ray_casting.py). */
static double cast(const uint8_t *jumps, int64_t rows, int64_t cols, double x, double y, double dx,
                   double dy, double longest)
{
    const int right = dx >= 0.0, up = dy >= 0.0;
    const uint8_t *ahead = jumps + (2 * up + right) * rows * cols;
    const double per_x = dx != 0.0 ? 1.0 / dx : INFINITY, per_y = dy != 0.0 ? 1.0 / dy : INFINITY;
    int64_t col = (int64_t)x, row = (int64_t)y;
    double t = 0.0;
    for (;;) {
        const int64_t side = ahead[row * cols + col];
        if (side == 0)
            return t;
        const double t_x = ((right ? col + side : col - side + 1) - x) * per_x;
        const double t_y = ((up ? row + side : row - side + 1) - y) * per_y;
        if (t_x < t_y) {
            t = t_x;
            col += right ? side : -side;
            if (t > longest || col < 0 || col >= cols)
                return INFINITY;
            int64_t to = (int64_t)(y + t * dy);
            to = to < row - side + 1 ? row - side + 1 : to;
            row = to > row + side - 1 ? row + side - 1 : to;
        } else {
            t = t_y;
            row += up ? side : -side;
            if (t > longest || row < 0 || row >= rows)
                return INFINITY;
            int64_t to = (int64_t)(x + t * dx);
            to = to < col - side + 1 ? col - side + 1 : to;
            col = to > col + side - 1 ? col + side - 1 : to;
        }
    }
}

/* A ray from every pose in every direction; poses lie in the grid. */
void cast_all(const uint8_t *jumps, int64_t rows, int64_t cols, const double *poses, int64_t n,
              const double *directions, int64_t beams, double cell_m, double max_m, double *ranges)
{
    for (int64_t i = 0; i < n; i++) {
        const double c = cos(poses[3 * i + 2]), s = sin(poses[3 * i + 2]);
        for (int64_t j = 0; j < beams; j++) {
            const double along = directions[2 * j], across = directions[2 * j + 1];
            const double cells =
                cast(jumps, rows, cols, poses[3 * i] / cell_m, poses[3 * i + 1] / cell_m,
                     c * along - s * across, s * along + c * across, max_m / cell_m);
            ranges[i * beams + j] = cells * cell_m < max_m ? cells * cell_m : max_m;
        }
    }
}

/* The same by marching over a field of Euclidean distances, as range_libc's fastest method
 * without a table of ranges does: not exact, a ray ends within half a cell of an obstacle. */
void march_all(const float *distances, int64_t rows, int64_t cols, const double *poses, int64_t n,
               const double *directions, int64_t beams, double cell_m, double max_m, double *ranges)
{
    const float longest = (float)(max_m / cell_m);
    for (int64_t i = 0; i < n; i++) {
        const float c = cosf((float)poses[3 * i + 2]), s = sinf((float)poses[3 * i + 2]);
        const float x = (float)(poses[3 * i] / cell_m), y = (float)(poses[3 * i + 1] / cell_m);
        for (int64_t j = 0; j < beams; j++) {
            const float along = (float)directions[2 * j], across = (float)directions[2 * j + 1];
            const float dx = c * along - s * across, dy = s * along + c * across;
            float t = 0.0f;
            while (t < longest) {
                const float at_x = x + t * dx, at_y = y + t * dy;
                if (!(at_x >= 0.0f && at_y >= 0.0f && at_x < cols && at_y < rows)) {
                    t = longest;
                    break;
                }
                const float clear = distances[(int64_t)at_y * cols + (int64_t)at_x];
                if (clear <= 0.0f)
                    break;
                t += clear * 0.999f > 1.0f ? clear * 0.999f : 1.0f;
            }
            ranges[i * beams + j] = (t < longest ? t : longest) * cell_m;
        }
    }
}

/* Mean and covariance of weighted poses whose headings lie near their mean. */
void gaussian(const double *poses, const double *weights, int64_t n, double *mean, double *cov)
{
    double x = 0, y = 0, c = 0, s = 0, p[6] = {0};
    for (int64_t i = 0; i < n; i++) {
        const double w = weights[i];
        x += w * poses[3 * i];
        y += w * poses[3 * i + 1];
        c += w * cos(poses[3 * i + 2]);
        s += w * sin(poses[3 * i + 2]);
    }
    mean[0] = x;
    mean[1] = y;
    mean[2] = atan2(s, c);
    for (int64_t i = 0; i < n; i++) {
        const double w = weights[i], a = poses[3 * i] - x, b = poses[3 * i + 1] - y;
        double d = poses[3 * i + 2] - mean[2];
        d -= 2.0 * M_PI * floor((d + M_PI) / (2.0 * M_PI));
        p[0] += w * a * a, p[1] += w * a * b, p[2] += w * a * d;
        p[3] += w * b * b, p[4] += w * b * d, p[5] += w * d * d;
    }
    for (int i = 0; i < 6; i++)
        cov[i] = p[i];
}
