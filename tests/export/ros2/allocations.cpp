// Counts what is allocated while a controller manager updates a controller: while it looks whether the robot rests, at
// every sample, with and without messages, to the end after a sensor has fallen silent. Prints updates, those that published, and allocations.
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <new>

namespace
{
bool counts = false;
long allocations = 0;
}  // namespace

void * operator new(std::size_t size)
{
  allocations += counts ? 1 : 0;
  return std::malloc(size);
}
void operator delete(void * place) noexcept { std::free(place); }
void operator delete(void * place, std::size_t) noexcept { std::free(place); }

struct Manager;
extern "C" {
Manager * create();
void set_whole(Manager *, const char *, std::int64_t);
int init(Manager *);
int configure(Manager *, unsigned int);
int activate(Manager *, int, int);
int update(Manager *, std::int64_t);
double * values(Manager *, int);
void send(Manager *, const double *, int);
void spin(Manager *);
void trajectory(Manager *, double, double);
void joint(Manager *, const char *);
void point(Manager *, double, int, int, const double *);
int send_goal(Manager *);
}

int main(int count, char **)
{
  Manager * manager = create();
  set_whole(manager, "publish_every", 3);
  if (init(manager) != 0 || configure(manager, 1000) != 0 || activate(manager, 0, 0) != 0) {
    return 1;
  }
  const double path[] = {0.1, 0.2, 0.3};
  int ended = 0;
  for (int sample = 0; sample < 111; ++sample) {
    if (sample == 56 || sample == 71) {
      if (count > 1) {  // a goal of two joints, which replaces the one before
        trajectory(manager, std::nan(""), 0.0);
        joint(manager, "elbow");
        joint(manager, "shoulder");
        point(manager, 0.5, 1, 2, path);
        if (send_goal(manager) == 0) {
          return 2;
        }
      } else {
        send(manager, path, 3);
      }
    }
    if (sample > 91) {
      values(manager, 0)[0] = std::nan("");
    }
    counts = true;
    ended += update(manager, 1000000);
    counts = false;
    if (sample % 4 != 0) {  // the thread that publishes is slower than the loop now and then
      spin(manager);
    }
  }
  std::printf("%d %ld\n", ended, allocations);
  return 0;
}
