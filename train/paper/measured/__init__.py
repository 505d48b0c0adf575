"""What the paper's figures and claims measure; nothing is drawn or judged here.

A section has one file name in three rooms: `measured/` says what is measured, `figures/` draws it, `claims/` judges it.

| file | section | figures |
|---|---|---|
| `via_points` | 3, policy search | 1 to 4 |
| `noise` | 4.1, exploration noise | 5 |
| `stable` | 4.2 and 4.3, stable exploration | 6 to 8 |
| `impedance` | 5, motion and stiffness | 9 to 14 |
| `digging` | 6, shoveling gravel | 15 to 17 |
"""
