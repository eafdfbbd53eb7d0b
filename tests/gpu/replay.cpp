/* Launches recorded from the emulator, run again in a process of their own: under a sanitizer, every array in memory of exactly
 * its size. Appended to emulator.program(text); ENTRIES lists its kernels. Usage: replay FILE THREADS CREWS. */

#include <stdio.h>

static FILE *replay_file;

template <typename T> static T replay_read() {
  T value;
  if (fread(&value, sizeof value, 1, replay_file) != 1) { fprintf(stderr, "replay: the file ends early\n"); exit(3); }
  return value;
}

struct replay_argument { void *pointer; union { int whole; double number; } value; };

int main(int count, char **words) {
  replay_file = fopen(words[1], "rb");
  int launches = replay_read<int>();
  for (int n = 0; n < launches; ++n) {
    char name[128] = {0};
    for (int k = 0, length = replay_read<int>(); k < length; ++k) name[k] = replay_read<char>();
    cuda_on_cpu_launch launch;
    for (unsigned &size : launch.grid) size = replay_read<unsigned>();
    launch.threads = atoi(words[2]); launch.crews = atoi(words[3]); launch.shared = replay_read<unsigned long>();
    int arguments = replay_read<int>();
    std::vector<replay_argument> held(arguments);
    std::vector<void *> pointers(arguments), owned;
    for (int k = 0; k < arguments; ++k) {
      char kind = replay_read<char>();
      pointers[k] = &held[k].value;
      if (kind == 'i') held[k].value.whole = replay_read<int>();
      if (kind == 'd') held[k].value.number = replay_read<double>();
      if (kind == 'n') held[k].pointer = 0, pointers[k] = &held[k].pointer;
      if (kind == 's') held[k].pointer = held[replay_read<int>()].pointer, pointers[k] = &held[k].pointer;
      if (kind != 'a') continue;
      long bytes = replay_read<long>();
      held[k].pointer = malloc(bytes + !bytes);
      if (bytes && fread(held[k].pointer, 1, bytes, replay_file) != (size_t)bytes) exit(3);
      owned.push_back(held[k].pointer);
      pointers[k] = &held[k].pointer;
    }
    int found = 0;
#define ENTRY(kernel) if (strcmp(name, #kernel) == 0) found = 1, launch_of_##kernel(&launch, pointers.data());
    ENTRIES
    for (void *memory : owned) free(memory);
    if (!found) { fprintf(stderr, "replay: no kernel %s\n", name); return 3; }
  }
  fclose(replay_file);
  printf("replayed %d launches\n", launches);
  return 0;
}
