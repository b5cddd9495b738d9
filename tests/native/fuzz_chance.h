/* Chance for the harnesses: numbers of every magnitude, the same in every run of a scene, whatever came before it. */
#ifndef CADCAM_FUZZ_CHANCE_H
#define CADCAM_FUZZ_CHANCE_H

#include <stdint.h>

void start(int scene);
uint64_t next(void);
int upto(int n);     /* 0 to n */
double unit(void);   /* 0 to 1 */
double around(void); /* -1 to 1 */
double wild(void);   /* mostly tame, sometimes as large or small as a double goes */
float wild_weight(void);
float gray(int kind); /* a pixel of a picture of one grey, of noise, of black and white */
void rotation(double R[9]);
double *doubles(int n, double scale); /* to be freed; a few of them wild, or no numbers */

#endif
