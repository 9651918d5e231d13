"""The live loop: a follower measures, an operator feels the patient's model now."""
