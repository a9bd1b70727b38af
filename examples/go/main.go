// Drive a robot of `rcpd demo` with generated types, and Go's own library alone.
package main

import (
	"context"
	"errors"
	"fmt"
	"log"
	"os"
	"time"

	"example/rcp"
)

var enough = errors.New("enough")

func main() {
	url, token := os.Getenv("RCP_URL"), os.Getenv("RCP_TOKEN")
	if url == "" {
		url = "http://127.0.0.1:8080"
	}
	if err := drive(rcp.New(url, token)); err != nil {
		log.Fatal(err)
	}
}

func drive(gateway *rcp.Gateway) error {
	ctx, stop := context.WithTimeout(context.Background(), 2*time.Minute)
	defer stop()

	left := 3
	err := rcp.AlphaPose.Watch(ctx, gateway, 5, func(update rcp.Update[rcp.PoseStamped]) error {
		fmt.Printf("%d x %.2f m\n", update.Seq, update.Body.Position.X)
		if left--; left == 0 {
			return enough
		}
		return nil
	})
	if !errors.Is(err, enough) {
		return err
	}

	var refused *rcp.Error
	if err := rcp.AlphaSpeedLimit.Write(ctx, gateway, 99, 0); !errors.As(err, &refused) {
		return fmt.Errorf("a speed of 99 m/s: %v", err)
	}
	fmt.Println("refused:", refused.Code)

	// Nobody else drives meanwhile. If the lease is lost, so is its context, and with it the command.
	lease, err := rcp.Acquire(ctx, gateway, "/tenant/alpha", 10*time.Second)
	if err != nil {
		return err
	}
	defer lease.Release(ctx)
	ctx = lease.Context

	goal := rcp.MoveToIn{Position: rcp.GoalPointIn{X: 0.5, Y: 0.5}}
	if _, err := rcp.AlphaMoveTo.Execute(ctx, gateway, goal); err != nil {
		return err
	}
	pose, err := rcp.AlphaPose.Read(ctx, gateway)
	if err != nil {
		return err
	}
	fmt.Printf("there: x %.1f y %.1f\n", pose.Position.X, pose.Position.Y)

	// A context that ends cancels the command, and the robot is at rest when Execute returns.
	short, end := context.WithTimeout(ctx, time.Second)
	defer end()
	far := rcp.MoveToIn{Position: rcp.GoalPointIn{X: 2.5, Y: 0.5}, Speed: rcp.Some(rcp.Float(0.2))}
	if _, err := rcp.AlphaMoveTo.Execute(short, gateway, far); !errors.As(err, &refused) {
		return fmt.Errorf("a cancelled command: %v", err)
	}
	fmt.Println("ended:", refused.Code)
	return nil
}
