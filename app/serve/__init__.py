"""The browser page: push the arm, bring obstacles, watch what it sees, feels and does."""
