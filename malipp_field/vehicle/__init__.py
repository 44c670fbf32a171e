"""From a plan to what each vehicle is to do, and to the mission files ground stations read."""
