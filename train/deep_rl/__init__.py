"""PPO and SAC on the tasks as Gymnasium environments."""
